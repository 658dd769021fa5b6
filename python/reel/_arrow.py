"""Types of columns, by Arrow's C data interface."""

from __future__ import annotations

import ctypes
from typing import Protocol


class HasSchema(Protocol):
    """Whatever gives its schema by Arrow's PyCapsule interface."""

    def __arrow_c_schema__(self) -> object: ...


class ArrowSchema(ctypes.Structure):
    """The start of a schema as Arrow's C data interface has it."""


ArrowSchema._fields_ = [
    ("format", ctypes.c_char_p),
    ("name", ctypes.c_char_p),
    ("metadata", ctypes.c_char_p),
    ("flags", ctypes.c_int64),
    ("n_children", ctypes.c_int64),
    ("children", ctypes.POINTER(ctypes.POINTER(ArrowSchema))),
]


def column_formats(table: HasSchema) -> list[str]:
    """The format string of each column, e.g. `l` for int64 and `d:20,0` for a decimal of 20 digits."""
    pointer_of = ctypes.pythonapi.PyCapsule_GetPointer
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    # the capsule owns the schema
    capsule = table.__arrow_c_schema__()
    schema = ArrowSchema.from_address(pointer_of(capsule, b"arrow_schema"))
    return [schema.children[at].contents.format.decode() for at in range(schema.n_children)]


def decimal_scales(table: HasSchema) -> list[int | None]:
    """Digits after the point of each column of decimals; None for columns of other types."""
    formats = column_formats(table)
    return [int(text.split(",")[1]) if text.startswith("d:") else None for text in formats]


__all__ = ["decimal_scales"]
