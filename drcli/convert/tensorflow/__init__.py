"""TensorFlow's file formats without TensorFlow."""
