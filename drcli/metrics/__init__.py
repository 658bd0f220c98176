"""Sends a training's figures to TensorBoard, Prometheus, InfluxDB, MLflow and trackio."""
