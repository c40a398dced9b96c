from __future__ import annotations

import pytest

from brdfpipe.report.formatting import length


@pytest.mark.parametrize(
    ("micrometres", "words"), [(0.943, "0.943 µm"), (0.00135, "1.35 nm"), (12.0, "12.0 µm"), (0.0, "0 µm")]
)
def test_small_heights_are_written_in_nanometres(micrometres: float, words: str) -> None:
    assert " ".join(length(micrometres)) == words
