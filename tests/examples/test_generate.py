"""The example materials are what their generator writes, and what it promises."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

from brdfpipe import vocabulary
from brdfpipe.surfaces import ingest, parameters

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = ("abs-grain", "pp-moulding", "paint-lab")
TEXTURES = ("leather-texture", "sparkling-texture")


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    specification = importlib.util.spec_from_file_location("generate", EXAMPLES / "generate.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def contents(folder: Path) -> dict[str, bytes]:
    names = (*NAMES, *TEXTURES)
    return {f"{name}/{path.name}": path.read_bytes() for name in names for path in sorted((folder / name).iterdir())}


def description(name: str) -> dict[str, Any]:
    return dict(yaml.safe_load((EXAMPLES / name / "material.yaml").read_text(encoding="utf-8")))


def percent(folder: Path) -> np.ndarray:
    return np.loadtxt(folder / "reflectance.txt", delimiter=";", skiprows=3)[:, 1]


def test_generating_anew_gives_the_committed_bytes(generate: ModuleType, tmp_path: Path) -> None:
    generate.write_materials(tmp_path)
    generate.write_textures(tmp_path)
    assert contents(tmp_path) == contents(EXAMPLES)


def test_the_examples_stay_small() -> None:
    assert sum(map(len, contents(EXAMPLES).values())) < 700_000


@pytest.mark.parametrize("name", [*NAMES, *TEXTURES])
def test_every_example_says_that_it_is_synthetic(name: str) -> None:
    assert "synthetic" in description(name)["description"]


def test_the_grain_is_isotropic_and_has_the_stated_slope() -> None:
    surface = ingest(EXAMPLES / "abs-grain" / "grain.x3p", description("abs-grain")["surface"])
    assert vocabulary.warnings(surface) == []
    assert surface.height.dtype == np.float32
    # The two parts of the relief are uncorrelated but for chance.
    assert float(parameters(surface).Sdq) == pytest.approx(0.2, abs=0.01)
    along_x, along_y = (float(surface.height.diff(dim).std()) for dim in "xy")
    # Some 30 grains fit into the field: the directions differ by chance, not by a lay.
    assert along_x / along_y == pytest.approx(1, abs=0.1)


def test_the_moulding_has_the_stated_slope_and_slightly_heavy_tails() -> None:
    assert description("pp-moulding")["surface"]["layout"] == "line"
    surface = ingest(EXAMPLES / "pp-moulding" / "profile.txt", {"layout": "line"})
    assert surface.height.shape == (4096,)
    assert float(parameters(surface).Rdq) == pytest.approx(0.08, abs=0.002)
    slope = surface.height.diff("x").values
    assert 3.1 < np.mean(slope**4) / np.mean(slope**2) ** 2 < 5


def test_the_black_plastic_reflects_more_than_its_interface_alone(generate: ModuleType, tmp_path: Path) -> None:
    # The smooth interface of n = 1.55 reflects ((n-1)/(n+1))² = 4.65 %.
    assert 4.9 < percent(EXAMPLES / "abs-grain").min() < percent(EXAMPLES / "abs-grain").max() < 5.5
    for variant in (1, 2, 3):
        folder = generate.write_materials(tmp_path, variant)[0]
        assert 4.9 < percent(folder).min() < percent(folder).max() < 5.5


def test_variants_have_their_own_names_and_contents(generate: ModuleType, tmp_path: Path) -> None:
    first, second = (generate.write_materials(tmp_path, variant) for variant in (1, 12))
    assert [folder.name for folder in first] == [f"{name}-001" for name in NAMES]
    assert [folder.name for folder in second] == [f"{name}-012" for name in NAMES]
    for one, other in zip(first, second, strict=True):
        data = "material.yaml" if one.name.startswith("paint") else "reflectance.txt"
        assert (one / data).read_bytes() != (other / data).read_bytes()
    slopes = [float(parameters(ingest(folder / "grain.x3p", {})).Sdq) for folder in (first[0], second[0])]
    assert slopes[0] != slopes[1]
    assert all(0.8 * 0.19 < slope < 1.2 * 0.21 for slope in slopes)


@pytest.mark.parametrize("variant", [-1, 1000])
def test_a_variant_without_a_name_is_refused(generate: ModuleType, tmp_path: Path, variant: int) -> None:
    with pytest.raises(ValueError, match="variant must lie in"):
        generate.write_materials(tmp_path, variant)
