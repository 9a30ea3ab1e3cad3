"""The contract of a store, on a folder and on a bucket: what an archive in one of them would lose in the other."""

from __future__ import annotations

import pytest

from lidarcodec.archive.stores.table import open_store
from lidarcodec.errors import SourceError

NAMES = ["a-b.json", "a/b.json", "a/c.json", "a0.json", "b.json"]
"""In the order of object stores."""


@pytest.fixture(params=["folder", pytest.param("bucket", marks=pytest.mark.sweep)])
def store(request, tmp_path):
    if request.param == "folder":
        return open_store(tmp_path / "store")
    request.getfixturevalue("bucket")
    return open_store(f"s3://fleet/{tmp_path.name}", retry_s=1)


def test_an_object_is_created_once_and_whole(store, tmp_path):
    file = tmp_path / "file"
    file.write_bytes(b"from a file")
    assert [store.create("x/one", b"first"), store.create("x/one", b"second"), store.create("two", file)] == [1, 0, 1]
    assert (store.read("x/one"), store.read("two")) == (b"first", b"from a file")
    assert (store.read("two", 5, 1), store.read_small("two", 11)) == (b"a", b"from a file")
    with pytest.raises(SourceError, match="more than 10 bytes"):
        store.read_small("two", 10)
    target = tmp_path / "copy"
    store.download("two", target)
    assert target.read_bytes() == b"".join(store.chunks("two", 4)) == b"from a file"


def test_an_upload_replaces_and_changes_the_tag(store):
    store.upload("x", [b"1", b"2"])
    before = store.entry("x")
    store.upload("x", [b"", b"345"])
    assert (store.read("x"), store.size("x")) == (b"345", 3)
    assert store.entry("x") == next(iter(store.entries())) != before


def test_a_listing_is_in_the_order_of_object_stores(store):
    for name in reversed(NAMES):
        store.create(name, b"1")
    assert [one.name for one in store.entries()] == NAMES
    assert [one.name for one in store.entries("a/")] == ["a/b.json", "a/c.json"]
    assert [one.name for one in store.entries("a/", "a/b.json")] == ["a/c.json"]
    assert [one.name for one in store.entries("", "a/b.json")] == NAMES[2:]
    assert list(store.entries("nothing/")) == []


def test_what_is_not_there_is_reported_and_deleting_it_is_no_error(store, tmp_path):
    store.create("x", b"1")
    for _ in range(2):
        store.delete("x")
    assert (store.entry("x"), store.size("x")) == (None, None)
    for asked in (
        lambda: store.read("x"),
        lambda: store.read("x", 0, 1),
        lambda: store.read_small("x", 9),
        lambda: store.download("x", tmp_path / "x"),
        lambda: list(store.chunks("x")),
    ):
        with pytest.raises(FileNotFoundError):
            asked()


@pytest.mark.parametrize("name", ["../x", "a/../../x", "/x", "", "a//b", "a/./b", "a\\b", "x\n", "x" * 1025])
def test_a_name_that_leaves_the_store_is_refused_by_everything(store, tmp_path, name):
    for asked in (
        lambda: store.read(name),
        lambda: store.read_small(name, 9),
        lambda: store.create(name, b"1"),
        lambda: store.upload(name, [b"1"]),
        lambda: store.delete(name),
        lambda: store.entry(name),
        lambda: store.download(name, tmp_path / "x"),
    ):
        with pytest.raises(SourceError):
            asked()
    assert list(store.entries()) == []
