"""The hash chain of a trace and the digests of its attachments, for `ingest_python.py` (docs/spec.md#hash-chain)."""

from blake3 import blake3

COVERED = {
    "/episode", "/tool/call", "/policy/output", "/user/dialogue", "/tool/result", "/world/diff", "/world/graph",
    "/reward", "/sim/digest",
}  # fmt: skip


class Chain:
    """The links of a trace as its messages come; `checked` says whether they are made anew or taken as they stand."""

    def __init__(self, checked):
        self.checked, self.links = checked, []
        self.hash = blake3(bytes(32))

    def covering(self, topic, take):
        """`take`, of a channel that the chain covers."""
        if not self.checked or topic not in COVERED:
            return take
        prefix = topic.encode() + b"\0"

        def cover(data, offset):
            self.hash.update(prefix + len(data).to_bytes(8, "little") + data)
            take(data, offset)

        return cover

    def link(self, found):
        """Takes a link. Refuses one that is not that of the messages before it."""
        if self.checked:
            if self.hash.digest() != found:
                raise ValueError(f"the hash chain is broken at link {len(self.links)}")
            self.hash = blake3(found)
        self.links.append(found)


def check_attachments(start, task_text, scene_text):
    """Refuses attachments of other digests than those of the header."""
    for name, text, expected in (("task", task_text, start.task_digest), ("scene", scene_text, start.scene_digest)):
        if blake3(text).digest() != expected:
            raise ValueError(f"the attached {name} is not the one of the header")
