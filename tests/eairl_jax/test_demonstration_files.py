"""The format of a source is found from the source, and what has none is refused with what was found."""

import json

import numpy as np
import pytest

from eairl_jax import InputError, demonstrations
from eairl_jax.demonstration_files import format_of, read


@pytest.fixture
def make(tmp_path):
    """Makes an empty file with its folders."""

    def touch(name, content=""):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
        return path

    return touch


@pytest.mark.parametrize(
    ("name", "source", "found"),
    [
        ("x.npz", "x.npz", "npz"),
        ("x.hdf5", "x.hdf5", "hdf5"),
        ("x.v1.h5", "x.v1.h5", "hdf5"),
        ("set-v0/data/metadata.json", "set-v0", "minari"),
        ("set-v0/data/metadata.json", "set-v0/data", "minari"),
        ("set/dataset_info.json", "set", "hf"),
        ("set/dataset_dict.json", "set", "hf"),
    ],
)
def test_files_and_folders_show_their_format(make, tmp_path, name, source, found):
    make(name)
    assert format_of(tmp_path / source) == format_of(str(tmp_path / source)) == found


def test_the_file_inside_a_minari_set_stands_for_the_set(make):
    make("set-v0/data/metadata.json")
    assert format_of(make("set-v0/data/main_data.hdf5")) == "minari"
    assert format_of(make("main_data.hdf5")) == "hdf5"
    assert format_of("minari:any/set-v0") == "minari"


@pytest.mark.parametrize(
    ("name", "source", "message"),
    [
        ("x.csv", "x.csv", r"unknown suffix '\.csv'; expected \.npz, \.hdf5, \.h5, a folder, or minari:NAME"),
        ("x", "x", r"unknown suffix ''"),
        ("set/readme.md", "set", r"set holds readme\.md: expected the folder of a Minari data set"),
        ("x.npz", "y.npz", "y.npz does not exist: check the path"),
        ("x.npz", ".", r"holds x\.npz: expected the folder"),
    ],
)
def test_what_has_no_format_is_refused(make, tmp_path, name, source, message):
    make(name)
    with pytest.raises(InputError, match=message):
        read(tmp_path / source)


def test_an_empty_folder_holds_nothing(tmp_path):
    with pytest.raises(InputError, match="holds nothing: expected"):
        read(tmp_path)


def test_a_format_may_be_given(make, tmp_path, make_episodes, expected, same):
    demos = expected(make_episodes([3, 4]))
    demonstrations.save(tmp_path / "x.npz", demos, {"task": "toy"})
    (tmp_path / "x.npz").rename(tmp_path / "x.data")
    same(read(tmp_path / "x.data", "npz").demos, demos)
    with pytest.raises(InputError, match="unknown format 'csv': choose minari, hf, hdf5, npz"):
        read(tmp_path / "x.data", "csv")


@pytest.mark.parametrize("format", ["npz", "hdf5"])
def test_a_folder_is_no_file(tmp_path, format):
    if format == "hdf5":
        pytest.importorskip("h5py")
    with pytest.raises(InputError, match="is no regular file"):
        read(tmp_path, format)


@pytest.mark.parametrize("content", ["", "not json", "[]", json.dumps({"data_format": "hdf5"})])
def test_damaged_metadata_of_minari_is_refused(make, tmp_path, content):
    make("set-v0/data/metadata.json", content)
    with pytest.raises(InputError):
        read(tmp_path / "set-v0")


def test_pickled_objects_are_never_made(tmp_path):
    np.savez(tmp_path / "x.npz", obs=np.array([{}]), reward=np.zeros(1))
    with pytest.raises(InputError, match="holds object: expected numbers"):
        read(tmp_path / "x.npz")
