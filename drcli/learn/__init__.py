"""The learner: tensors in, tensors out, no files and no processes."""
