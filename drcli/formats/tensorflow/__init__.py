"""File formats of TensorFlow, read and written without it."""
