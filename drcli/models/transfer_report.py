"""What a transfer did, as far as uploads and downloads have it in common."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class TransferReport:
    """What was done.

    Attributes:
        source: The model, as an s3:// address.
        target: The copy, the same.
        checkpoint: Name of the checkpoint that counts; the last one of a whole model.
        copied: Names of the objects that travelled, below the target.
        copied_bytes: Their size.
        unchanged: Names of those that were there already.
        deleted: Names of those that -w deleted.
        dry_run: Whether nothing of this was really done.
    """

    source: str
    target: str
    checkpoint: str
    copied: list[str] = field(default_factory=list)
    copied_bytes: int = 0
    unchanged: list[str] = field(default_factory=list)
    deleted: list[str] = field(default_factory=list)
    dry_run: bool = False
