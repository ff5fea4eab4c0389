"""HDF5 files that lie: each array is checked before it is read."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from npred.base.errors import StoreError
from npred.lab.training.data import hdf5

NUMBERS = np.arange(12.0).reshape(4, 3)


def read(path: Path) -> np.ndarray:
    with hdf5.opened(path, {"X": 2}) as arrays:
        return arrays["X"][:]


def write(path: Path, **options: Any) -> Path:
    with h5py.File(path, "w") as file:
        file.create_dataset("X", **({"data": NUMBERS} | options))
    return path


def joined(path: Path, source: str, name: str = "X", shape: tuple[int, int] = (4, 3)) -> Path:
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[:4] = h5py.VirtualSource(source, name, shape=(4, 3))
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("X", layout)
    return path


@pytest.mark.parametrize(
    "options", [{}, {"chunks": (2, 3)}, {"compression": "gzip", "shuffle": True}, {"fletcher32": True}]
)
def test_plain_arrays_are_read(tmp_path: Path, options: dict[str, Any]):
    assert (read(write(tmp_path / "a.h5", **options)) == NUMBERS).all()


def test_shards_beside_the_file_are_joined(tmp_path: Path):
    write(tmp_path / "shard-0.h5")
    assert (read(joined(tmp_path / "a.h5", "shard-0.h5")) == NUMBERS).all()


@pytest.mark.parametrize(
    "source", ["../secret.h5", "sub/s.h5", "/etc/s.h5", ".", "a.h5", ".hidden.h5", "shard 1.h5", "none.h5"]
)
def test_shards_elsewhere_are_refused(tmp_path: Path, source: str):
    write(tmp_path / "secret.h5")
    folder = tmp_path / "here"
    (folder / "sub").mkdir(parents=True)
    write(folder / "sub" / "s.h5")
    write(folder / ".hidden.h5")
    with pytest.raises(StoreError, match=r"a\.h5: expected the arrays X, got: "):
        read(joined(folder / "a.h5", source))


def test_a_shard_behind_a_link_or_joined_itself_is_refused(tmp_path: Path):
    write(tmp_path / "x")
    (tmp_path / "link.h5").symlink_to(tmp_path / "x")
    write(tmp_path / "s.h5")
    joined(tmp_path / "chain.h5", "s.h5")
    for source, words in (("link.h5", "link.h5 is a link"), ("chain.h5", "itself joined")):
        with pytest.raises(StoreError, match=words):
            read(joined(tmp_path / "a.h5", source))


def test_links_out_of_the_file_are_refused(tmp_path: Path):
    write(tmp_path / "s.h5")
    for link in (h5py.ExternalLink("s.h5", "/X"), h5py.SoftLink("/Y")):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["Y"] = NUMBERS
            file["X"] = link
        with pytest.raises(StoreError, match="X is missing, or a link to elsewhere"):
            read(tmp_path / "a.h5")


def test_a_link_on_the_way_is_refused_also_behind_a_virtual_array(tmp_path: Path):
    (tmp_path / "other").mkdir()
    write(tmp_path / "other" / "secret.h5")
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["g"] = h5py.ExternalLink("other/secret.h5", "/")
        file["a/b"] = NUMBERS
    for name in ("g/X", "/g/X", "a/b"):
        with pytest.raises(StoreError, match=rf"X is joined from '{name}' of s\.h5"):
            read(joined(tmp_path / "a.h5", "s.h5", name))
    with hdf5.opened(tmp_path / "s.h5", {"a/b": 2}) as arrays:
        assert (arrays["a/b"][:] == NUMBERS).all()
    for name in ("g/X", "a/b/c", "none/X"):
        with (
            pytest.raises(StoreError, match=f"{name} is missing, or a link"),
            hdf5.opened(tmp_path / "s.h5", {name: 2}),
        ):
            pass


def test_numbers_kept_in_another_file_are_refused(tmp_path: Path):
    (tmp_path / "raw").write_bytes(NUMBERS.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("X", shape=(4, 3), dtype="f8", external=[(str(tmp_path / "raw"), 0, 96)])
    with pytest.raises(StoreError, match="kept in another file"):
        read(tmp_path / "a.h5")


def test_a_filter_that_would_be_loaded_is_refused(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_chunk((4, 3))
        layout.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, ())  # blosc's number
        space, kind = h5py.h5s.create_simple((4, 3)), h5py.h5t.NATIVE_DOUBLE
        h5py.h5d.create(file.id, b"X", kind, space, layout)
    with pytest.raises(StoreError, match=r"filter \[32001\]"):
        read(tmp_path / "a.h5")


@pytest.mark.parametrize("options", [{}, {"chunks": (1000, 3)}, {"chunks": (1000, 3), "compression": "gzip"}])
def test_no_room_is_made_for_an_array_that_is_not_there(tmp_path: Path, options: dict[str, Any]):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("X", shape=(10**13, 3), dtype="f8", **options)
    with pytest.raises(StoreError, match="larger than what is stored of it"):
        read(tmp_path / "a.h5")
    write(tmp_path / "s.h5")
    with pytest.raises(StoreError, match="larger than what is stored of it"):
        read(joined(tmp_path / "b.h5", "s.h5", shape=(10**13, 3)))


@pytest.mark.parametrize("data", [np.arange(3.0), ["text"], np.zeros((4, 3), dtype="c16"), np.zeros(3, dtype="i4,f8")])
def test_what_is_no_table_of_numbers_is_refused(tmp_path: Path, data: Any):
    with pytest.raises(StoreError, match="X"):
        read(write(tmp_path / "a.h5", data=data))


def test_groups_and_other_files_are_refused(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("X")
    (tmp_path / "b.h5").write_bytes(b"no HDF5")
    for name, words in (("a.h5", "no array of numbers"), ("b.h5", "signature"), ("c.h5", "no regular file")):
        with pytest.raises(StoreError, match=words):
            read(tmp_path / name)
