import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from brink.search.document import Document
from brink.search.errors import DocumentError

JSON_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
ARRAYS = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.bool_, np.uint8]),
    hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4),
)


def document(**changes: object) -> Document:
    fields: dict[str, object] = {
        "kind": "mlcshe@1",
        "version": 3,
        "header": {"seed": 7, "names": ["a", "b"]},
        "arrays": {"rows": np.arange(6.0).reshape(2, 3), "flags": np.array([True, False])},
    }
    return Document(**(fields | changes))  # type: ignore[arg-type]


@given(
    header=st.dictionaries(st.text(), JSON_VALUES, max_size=4),
    arrays=st.dictionaries(st.from_regex(r"[a-z_]{1,12}", fullmatch=True), ARRAYS, max_size=4),
)
@settings(deadline=None)
def test_document_comes_back_as_it_was_stored(
    header: dict[str, object], arrays: dict[str, np.typing.NDArray[np.generic]]
) -> None:
    stored = document(header=header, arrays=arrays)
    back = Document.from_bytes(stored.to_bytes())
    assert (back.kind, back.version, back.header) == ("mlcshe@1", 3, header)
    assert set(back.arrays) == set(arrays)
    for name, array in arrays.items():
        assert back.arrays[name].dtype == array.dtype
        assert back.arrays[name].shape == array.shape
        assert back.arrays[name].tobytes() == array.tobytes()


def test_equal_documents_have_equal_bytes_whatever_the_order_of_their_parts() -> None:
    turned = document(
        header={"names": ["a", "b"], "seed": 7},
        arrays={"flags": np.array([True, False]), "rows": np.arange(6.0).reshape(2, 3)},
    )
    assert document().to_bytes() == turned.to_bytes()


@given(position=st.integers(0, 10_000), bit=st.integers(0, 7))
@settings(deadline=None)
def test_any_flipped_bit_is_noticed(position: int, bit: int) -> None:
    data = bytearray(document().to_bytes())
    data[position % len(data)] ^= 1 << bit
    with pytest.raises(DocumentError):
        Document.from_bytes(bytes(data))


@pytest.mark.parametrize("length", [0, 5, 40, 200])
def test_cut_document_is_refused(length: int) -> None:
    with pytest.raises(DocumentError):
        Document.from_bytes(document().to_bytes()[:length])


def test_objects_and_numbers_without_json_form_are_refused() -> None:
    with pytest.raises(DocumentError, match="expected numbers"):
        document(arrays={"rows": np.array([{}], dtype=object)}).to_bytes()
    with pytest.raises(DocumentError, match="plain JSON"):
        document(header={"seed": float("nan")}).to_bytes()
    with pytest.raises(DocumentError, match="plain JSON"):
        document(header={"seed": {1, 2}}).to_bytes()


def test_document_of_another_kind_or_version_is_refused() -> None:
    assert document().expect("mlcshe@1", 3).header["seed"] == 7
    with pytest.raises(
        DocumentError, match="expected a document of ga@1, version 3; got 'mlcshe@1', version 3"
    ):
        document().expect("ga@1", 3)
    with pytest.raises(DocumentError, match="version 4"):
        document().expect("mlcshe@1", 4)
