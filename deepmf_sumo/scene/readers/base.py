"""What a reader is: a file or folder -> the recordings in it -> raw scenes.

A reader says what recordings there are under a root (`Reader.recordings`) and loads one of them
(`Reader.load`). It neither checks nor repairs what is written there: `raw.repair.repair` does so
for all formats, so that the same fault has the same outcome in each. It needs no limits either: the
package calls it in a process that may be ended (`readers.scenes`, `readers.read`).

A root is a file, since most formats are recognised by the first bytes of a file. A data set whose
scene is a folder, or whose folder holds more than recordings, has a `FolderReader` besides.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import Scene
from deepmf_sumo.scene.readers.raw import RawScene


class UnknownFormatError(ReaderError):
    """The root is of no format that is known: no recording, as far as can be told."""


class UnreadableError(ReaderError):
    """The root cannot be opened, or its first bytes not be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A record that cannot be used, and why."""

    file: str
    record: int
    name: str
    reason: str
    dataset: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordRef:
    """The location of a recorded scene, which `scene.readers.read` reads without a search.

    Attributes:
        file: the root: a file, or the folder of a scene.
        name: the scene's id; where the record has none that can be read, a reader leaves it empty,
            and the package gives the root's name and the record's number.
        record: index of the record under the root.
        reader: the plug-in that reads the root, as the package notes it; empty if the root could
            not be listed to its end.
        offset: what else the reader needs to find the record, e.g. its position in the file.
        content: what the reader has read of the record already, for `Reader.load` alone; it is not
            kept.
    """

    file: Path
    name: str
    record: int
    reader: str = ""
    offset: int | None = None
    content: Any = field(default=None, compare=False, repr=False)


class Reader(Protocol):
    """A format. A module with these two functions is a reader, and so is a class without arguments.

    Files are opened by `deepmf_sumo.files` alone, which refuses pipes, devices and too large ones.
    """

    def recordings(self, root: Path) -> Iterable[RecordRef]:
        """The recordings under a root in order, whether or not they can be used.

        None if the root is not of this format, which its first bytes say rather than its name. All
        readers are asked, so this has to be quick. Raises ReaderError, with the root and the reason
        in a sentence, if it is of this format and cannot be listed, or not to its end.
        """
        ...

    def load(self, ref: RecordRef) -> RawScene | Scene:
        """What is written at a location from `recordings`, which may be an earlier process's.

        A Scene is for the package's own format: it is checked, but never repaired. Raises
        ReaderError, with the root and the reason in a sentence, if it cannot be loaded.
        """
        ...


@runtime_checkable
class FolderReader(Protocol):
    """A reader of data sets with folders of their own."""

    def roots(self, folder: Path) -> Sequence[Path] | None:
        """The roots in a folder, which can be the folder itself; None for a folder of no interest.

        The rest of the folder is left out then. Asked of every folder that is searched, in the
        process of the caller. Raises UsageError where a package that the reader needs is missing.
        """
        ...
