"""The supervisor as a process of its own, started by `drcli.runs.training.launch`."""

from drcli.job import Job
from drcli.runs.training import supervise_job

if __name__ == "__main__":
    raise SystemExit(supervise_job(Job.from_environment()))
