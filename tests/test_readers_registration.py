"""A reader is one module and one line of registration: keys, messages and the documentation follow."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from brdfpipe.catalogue import generated_files
from brdfpipe.catalogue.material_keys import MeasuredSpectrum, MeasuredSurface
from brdfpipe.descriptions import rendering
from brdfpipe.errors import InputError
from brdfpipe.spectra import readers
from brdfpipe.spectra.formats import registry
from brdfpipe.spectra.formats.sample import FRACTION, Sample, SpectrumFormat
from brdfpipe.surfaces import reading
from brdfpipe.surfaces.heights import Heights, SurfaceFormat

WAVELENGTH = np.arange(380.0, 781, 10)


def toy_spectrum(path: Path) -> tuple[list[Sample], list[str]]:
    return [Sample("toy", WAVELENGTH, np.full(WAVELENGTH.size, float(path.read_text())), (FRACTION,))], []


def toy_surface(path: Path, *, unit: str = "um") -> Heights:
    assert unit == "um"
    return Heights(np.random.default_rng(int(path.read_text())).normal(0, 0.1, (64, 64)), 0.5, 0.5)


def test_a_new_spectrum_format_is_read_offered_and_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.FORMATS, "toy", SpectrumFormat("toy", (".toy",), "one number", toy_spectrum))
    (tmp_path / "a.toy").write_text("0.25")
    spectrum = readers.read_spectrum(tmp_path / "a.toy", geometry="sci")
    assert (spectrum["total_reflectance"] == 0.25).all()
    assert "toy" in json.loads(rendering.editor_schema(MeasuredSpectrum))["properties"]["format"]["enum"]
    with pytest.raises(InputError, match=r"accepted: .*\.toy"):
        readers.read_spectrum(tmp_path / "a.unknown", geometry="sci")
    assert "| `toy` | `.toy` | one number |" in generated_files.key_tables()["docs/materials.md"]["formats of spectra"]


def test_a_new_surface_format_is_read_offered_and_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toy = SurfaceFormat("toy", toy_surface, (".toy",), "nothing", ("unit",))
    monkeypatch.setitem(reading.FORMATS, "toy", toy)
    (tmp_path / "a.toy").write_text("1")
    assert reading.read_surface(tmp_path / "a.toy", unit="um").sizes == {"y": 64, "x": 64}
    assert "toy" in json.loads(rendering.editor_schema(MeasuredSurface))["properties"]["format"]["enum"]
    with pytest.raises(InputError, match=r"accepted: .*\.toy"):
        reading.read_surface(tmp_path / "a.unknown")
    assert "| `toy` | `.toy` | nothing |" in generated_files.key_tables()["docs/materials.md"]["formats of surfaces"]
