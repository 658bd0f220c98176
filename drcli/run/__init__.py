"""A run: plan, launch, supervise, record, report and stop a training or an evaluation."""
