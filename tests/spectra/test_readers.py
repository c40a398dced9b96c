"""Spectra from text files: the real ones, every quirk in small, and every refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.spectra import ingest, read_spectrum
from brdfpipe.spectra.colour_science import colour
from brdfpipe.spectra.recovery import specular_reflectance
from brdfpipe.store import save_dataset
from brdfpipe.vocabulary import validate, warnings

HEAD = "wavelength [nm];R [%]\n"
ROWS = "".join(f"{nm};{20 + nm / 100:g}\n" for nm in range(400, 701, 20))


@pytest.fixture
def read(tmp_path: Path):
    def reader(text: str, **options):
        path = tmp_path / "sample.csv"
        path.write_text(text, encoding="utf-8")
        return validate(read_spectrum(path, **{"geometry": "sci", **options}), "spectrum")

    return reader


def test_a_german_file_in_percent_and_latin_1_is_read(shared_data: Path) -> None:
    spectrum = read_spectrum(shared_data / "spectra" / "pvc_white_de.csv", geometry="sci")
    assert spectrum["wavelength"].values.tolist() == list(range(360, 781, 5))
    assert spectrum["total_reflectance"].sel(wavelength=[360, 450, 780]).values == pytest.approx(
        [0.08769, 0.61456, 0.7083]
    )
    for words in ("Latin-1", "decimal commas", "percent was converted"):
        assert words in spectrum.attrs["history"]


def test_an_irregular_grid_is_preserved_and_a_missing_scale_refused(shared_data: Path) -> None:
    path = shared_data / "spectra" / "hdpe_yellow_irregular.txt"
    with pytest.raises(InputError, match=r"ambiguous scale: fraction, or percent.*fraction or percent") as refusal:
        read_spectrum(path, geometry="sci")
    assert refusal.value.key == "spectrum.scale"
    spectrum = read_spectrum(path, geometry="sci", scale="fraction")
    assert spectrum["wavelength"].values[:3].tolist() == [370, 377, 379]
    assert spectrum["total_reflectance"].values[0] == 0.08368


def test_micrometres_and_sentinels_are_understood(shared_data: Path) -> None:
    spectrum = read_spectrum(shared_data / "spectra" / "fibreglass_green_um_sentinel.txt", geometry="sci")
    assert spectrum["wavelength"].values[0] == 360.6
    assert spectrum["total_reflectance"].values[0] == pytest.approx(6.6503137e-02, rel=1e-12)
    assert "13 rows without a value were dropped" in spectrum.attrs["history"]


def test_a_descending_file_in_micrometres_and_percent_is_sorted_and_limited(shared_data: Path) -> None:
    spectrum = read_spectrum(shared_data / "spectra" / "pipe_blue_ecostress_style.txt", geometry="sci")
    assert spectrum["wavelength"].values[[0, -1]].tolist() == [360, 830]
    assert float(spectrum["total_reflectance"].sel(wavelength=830)) == pytest.approx(0.646123, rel=1e-12)
    assert "sorted by wavelength" in spectrum.attrs["history"]
    assert "outside 360–830 nm were left out" in spectrum.attrs["history"]


def test_a_named_standard_deviation_becomes_the_uncertainty(shared_data: Path) -> None:
    path = shared_data / "spectra" / "abs_black_3col.txt"
    spectrum = read_spectrum(path, geometry="sce", scale="fraction")
    assert (spectrum["total_reflectance_u"] == 0.0004).all()
    assert warnings(spectrum) == []


@pytest.mark.parametrize("index", [None, 1.55])
def test_a_black_below_the_fresnel_reflectance_warns_that_the_specular_was_excluded(
    shared_data: Path, tmp_path: Path, index: float | None
) -> None:
    spec = {"file": "abs_black_3col.txt", "geometry": "sci", "scale": "fraction"}
    labelled = shared_data / "spectra" / "abs_black_3col.txt"
    with pytest.raises(InputError, match=r"labelled SCE, and the description says SCI; .*accepted: `geometry: sce`"):
        ingest(spec, labelled, index)
    unlabelled = tmp_path / labelled.name
    unlabelled.write_text(labelled.read_text().replace("SCE", "R"))
    messages = " ".join(warnings(ingest(spec, unlabelled, index)))
    assert f"specular reflectance of a smooth surface of index {index or 1.45:g}" in messages
    assert "set `spectrum.geometry: sce`" in messages


def test_the_same_black_with_the_specular_excluded_gives_no_warning(shared_data: Path) -> None:
    spec = {"file": "abs_black_3col.txt", "geometry": "sce", "scale": "fraction"}
    assert warnings(ingest(spec, shared_data / "spectra" / "abs_black_3col.txt", 1.55)) == []


def test_a_reflectance_just_above_one_is_kept_and_warned_about(shared_data: Path) -> None:
    spectrum = read_spectrum(shared_data / "spectra" / "munsell_over_unity.csv", geometry="sci", scale="fraction")
    assert spectrum["total_reflectance"].max() == 1.066161
    assert any("exceeds 1 at 5 wavelengths from 690 to 730 nm" in warning for warning in warnings(spectrum))


def test_an_unknown_extension_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        InputError, match=r"unknown file extension; found \.sp; accepted: \.asc, .*\.cxf, .*\.txt.*`spectrum\.format`"
    ):
        read_spectrum("vinyl_red.sp", geometry="sci")


@pytest.mark.parametrize(("nm", "value"), [(500, "64"), (520, "2")])
def test_a_value_off_its_neighbours_is_warned_about(read, nm: int, value: str) -> None:
    spectrum = read(rows(400, 700).replace(f"{nm};50", f"{nm};{value}"))
    assert f"at {nm} nm differs" in warnings(spectrum)[0]
    assert len(warnings(spectrum)) == 1


def test_a_value_off_its_neighbours_is_warned_about_in_a_dark_sample_too(read) -> None:
    dark = [2.6 - nm / 1000 for nm in range(0, 301, 10)]
    dark[12] += 0.3
    text = HEAD + "".join(f"{nm};{r:.4f}\n" for nm, r in zip(range(400, 701, 10), dark, strict=True))
    assert "0.0278 at 520 nm differs by 0.003 from its neighbours" in warnings(read(text))[0]


def test_two_outliers_are_both_warned_about(read) -> None:
    messages = " ".join(warnings(read(rows(400, 700).replace("500;50", "500;60").replace("520;50", "520;40"))))
    assert "at 500 nm differs" in messages
    assert "at 520 nm differs" in messages


@pytest.mark.parametrize(("nm", "value"), [(400, "57"), (700, "42")])
def test_the_first_and_the_last_value_are_checked(read, nm: int, value: str) -> None:
    assert f"at {nm} nm differs" in warnings(read(rows(400, 700).replace(f"{nm};50", f"{nm};{value}")))[0]


@pytest.mark.parametrize("noise", [0.05, 0.5, 2])
@pytest.mark.parametrize("step", [1, 5, 10])
def test_noise_gives_no_warning(read, noise: float, step: int) -> None:
    random, nm = np.random.default_rng(7), np.arange(400, 701, step)
    for _ in range(20):
        values = 10 + 60 / (1 + np.exp((random.uniform(450, 650) - nm) / 15)) + noise * random.standard_normal(nm.size)
        assert warnings(read(HEAD + "".join(f"{w};{r:.3f}\n" for w, r in zip(nm, values, strict=True)))) == []


def test_coarse_digits_give_no_warning(read) -> None:
    level = [50, 50, 51, 50, 50, 50, 49, 49, 50, 51, 51, 50, 50, 50, 50, 51]
    text = HEAD + "".join(f"{nm};{r}\n" for nm, r in zip(range(400, 701, 20), level, strict=True))
    assert warnings(read(text)) == []


def test_no_patch_of_the_color_checkers_is_warned_about(read) -> None:
    for patches in colour.SDS_COLOURCHECKERS.values():
        for patch in patches.values():
            values = zip(patch.wavelengths, patch.values, strict=True)
            text = "nm;R fraction\n" + "".join(f"{w:g};{r:.4f}\n" for w, r in values if 380 <= w <= 780)
            assert warnings(read(text)) == []


def test_a_narrow_peak_and_a_steep_edge_give_no_warning(read) -> None:
    nm = np.arange(400, 701, 10)
    for shape in (80 * np.exp(-(((nm - 550) / 12) ** 2)), 90 / (1 + np.exp((500 - nm) / 6))):
        text = HEAD + "".join(f"{w};{r:.4f}\n" for w, r in zip(nm, shape, strict=True))
        assert warnings(read(text)) == []


def test_a_jump_between_level_stretches_is_warned_about(read) -> None:
    text = HEAD + "".join(f"{nm};{20 if nm < 550 else 70}\n" for nm in range(400, 701, 10))
    assert "jumps by 0.5 from 540 to 550 nm" in warnings(read(text))[0]


def test_a_wavelength_out_of_order_is_warned_about(read) -> None:
    assert "not monotonic" in warnings(read(rows(400, 700).replace("550;50", "655;50")))[0]


def test_a_lost_row_and_a_mistyped_wavelength_are_warned_about(read) -> None:
    lost = warnings(read(rows(400, 700).replace("550;50\n", "")))
    assert lost == [
        "sample.csv: the step from 540 to 560 nm differs from the others. Look for a lost row or a mistyped wavelength."
    ]
    assert "the step from 550 to 566 nm" in warnings(read(rows(400, 700).replace("560;50", "566;50")))[0]
    # A row without a value is one that the instrument left out.
    assert warnings(read(rows(400, 700).replace("550;50", "550;NaN"))) == []


def test_the_number_of_rows_and_the_ends_that_a_header_states_are_compared(read) -> None:
    head = "Number of X Values: 31\nFirst X Value: 400\nLast X Value: 700\n"
    assert warnings(read(head + rows(400, 700))) == []
    messages = warnings(read(head + rows(400, 720)))
    assert "the header states 31 rows, 33 were found" in messages[0]
    assert "the header states a last X of 700, 720 was found" in messages[1]


def test_a_number_cut_short_is_warned_about(read) -> None:
    text = HEAD + "".join(f"{nm};{nm / 20:.3f}\n" for nm in range(400, 701, 10))
    assert warnings(read(text)) == []
    assert warnings(read(text.removesuffix("00\n"))) == [
        "sample.csv: 35.0 in line 32 has another number of decimals than the others. Look for a number that was cut or damaged."
    ]


def test_repeated_readings_that_disagree_are_warned_about(read) -> None:
    assert "readings at 600 nm differ by 0.1 from their mean" in warnings(read(rows(400, 700) + "600;30\n"))[0]
    assert warnings(read(rows(400, 700) + "600;51\n")) == []


def test_a_percent_header_makes_dark_values_percent(read) -> None:
    dark = "".join(f"{nm};1.5\n" for nm in range(400, 701, 20))
    assert (read(HEAD + dark, geometry="sce")["total_reflectance"] == 0.015).all()


def test_values_above_2_without_a_stated_scale_are_percent(read) -> None:
    spectrum = read("nm;R\n" + ROWS)
    assert float(spectrum["total_reflectance"][0]) == 0.24
    assert "the header states no scale, and values reach 27" in spectrum.attrs["history"]


def test_the_option_overrides_the_header_and_says_so(read) -> None:
    rows = "".join(f"{nm};0.5\n" for nm in range(400, 701, 20))
    spectrum = read(HEAD + rows, scale="fraction")
    assert (spectrum["total_reflectance"] == 0.5).all()
    assert "header says percent; `spectrum.scale: fraction` in material.yaml was used" in warnings(spectrum)[0]


def test_percent_stated_as_a_fraction_is_refused(read) -> None:
    with pytest.raises(InputError, match="the scale is `fraction`, but values exceed 1; found up to 27"):
        read("nm;R\n" + ROWS, scale="fraction")


def test_repeated_wavelengths_are_averaged_and_their_uncertainties_as_squares(read) -> None:
    rows = "".join(f"{nm} 30 1\n" for nm in range(400, 701, 20))
    spectrum = read("nm R% std\n" + rows + "400 40 7\n")
    assert float(spectrum["total_reflectance"][0]) == 0.35
    assert float(spectrum["total_reflectance_u"][0]) == pytest.approx(0.05)
    assert "1 rows of repeated wavelength were averaged" in spectrum.attrs["history"]


def test_an_uncertainty_as_large_as_the_reflectance_is_warned_about(read) -> None:
    text = "nm;R %;std\n" + "".join(f"{nm};30;28\n" for nm in range(400, 701, 20))
    assert "Is it a second sample?" in warnings(read(text))[-1]


WIDE = "nm,red,blue,std\n" + "".join(f"{nm},0.7,0.2,0.01\n" for nm in range(400, 701, 20))


@pytest.mark.parametrize(("column", "value"), [(2, 0.7), (3, 0.2), ("Blue", 0.2), ("red", 0.7)])
def test_a_column_is_chosen_by_number_or_name(read, column: int | str, value: float) -> None:
    spectrum = read(WIDE, column=column, scale="fraction")
    assert (spectrum["total_reflectance"] == value).all()
    assert ("total_reflectance_u" in spectrum) == (value == 0.2)
    assert warnings(spectrum) == []


def test_unread_columns_are_warned_about_unless_one_was_chosen(read) -> None:
    spectrum = read(WIDE, scale="fraction")
    assert (spectrum["total_reflectance"] == 0.7).all()
    assert "column 2 (red) was read; ignored: column 3 (blue), column 4 (std)" in warnings(spectrum)[0]


def test_an_untitled_third_column_is_an_uncertainty_only_on_request(read) -> None:
    rows = "".join(f"{nm} 30 1\n" for nm in range(400, 701, 20))
    assert "total_reflectance_u" not in read(rows)
    assert (read(rows, column=2, uncertainty=3)["total_reflectance_u"] == 0.01).all()


def three(title: str, doubt: str, unit: str = "[%]", value: float = 30) -> str:
    return f"nm;R {unit};{title}\n" + "".join(f"{nm};{value:g};{doubt}\n" for nm in range(400, 701, 20))


@pytest.mark.parametrize(
    "title",
    [
        "u",
        "u_R [%]",
        "R_std",
        "R std [%]",
        "Standardabweichung",
        "Messunsicherheit [%]",
        "sigma",
        "σ(R)",
        "sd",
        "std. dev.",
    ],
)
def test_a_title_that_begins_or_ends_with_a_word_for_it_is_an_uncertainty(read, title: str) -> None:
    assert read(three(title, "0.6"))["total_reflectance_u"].values == pytest.approx(0.006)


@pytest.mark.parametrize(
    "titles", ["coated %;uncoated %", "red %;understated %", "BAT;STD", "STD;BAT", "R %;Stdlib", "R %;errant"]
)
def test_a_word_that_only_starts_like_an_uncertainty_is_another_sample(read, titles: str) -> None:
    text = f"nm;{titles}\n" + "".join(f"{nm};60;25\n" for nm in range(400, 701, 20))
    spectrum = read(text, scale="percent")
    assert "total_reflectance_u" not in spectrum
    assert spectrum["total_reflectance"].values == pytest.approx(0.6)
    assert "ignored: column 3" in warnings(spectrum)[0]


@pytest.mark.parametrize("title", ["U (k=2) [%]", "U_R [%], k = 2", "2σ [%]", "2 sigma [%]"])
def test_an_expanded_uncertainty_is_divided_by_its_coverage_factor(read, title: str) -> None:
    spectrum = read(three(title, "0.6"))
    assert spectrum["total_reflectance_u"].values == pytest.approx(0.003)
    assert "after division by k = 2" in spectrum.attrs["history"]
    assert warnings(spectrum) == []


@pytest.mark.parametrize(
    ("title", "unit", "doubt", "why"),
    [
        ("U", "[%]", "0.6", "does not state the coverage factor"),
        ("U (95 %)", "[%]", "0.6", "does not state the coverage factor"),
        ("relative u [%]", "[%]", "0.6", "relative to the reflectance"),
        ("u_rel", "[%]", "0.6", "relative to the reflectance"),
        ("u [% of R]", "[%]", "0.6", "relative to the reflectance"),
        ("u [%]", "[0-1]", "0.6", "may be relative"),
        ("std² [%]", "[%]", "0.6", "a variance"),
        ("variance", "[%]", "0.6", "a variance"),
        ("u [%]", "[%]", "-0.6", "16 values are negative, the first in line 2"),
    ],
)
def test_columns_that_are_not_absolute_standard_uncertainties_are_ignored(
    read, title: str, unit: str, doubt: str, why: str
) -> None:
    text = three(title, doubt, unit, 0.3 if unit == "[0-1]" else 30)
    spectrum = read(text)
    assert "total_reflectance_u" not in spectrum
    (warning,) = warnings(spectrum)
    assert why in warning
    assert "as in `U (k=2)`" in warning
    with pytest.raises(InputError, match="is not a standard uncertainty") as refusal:
        read(text, uncertainty=3)
    assert refusal.value.key == "spectrum.uncertainty"


def test_an_uncertainty_without_a_unit_beside_percent_is_read_in_percent_with_a_warning(read) -> None:
    spectrum = read(three("u", "0.6"))
    assert spectrum["total_reflectance_u"].values == pytest.approx(0.006)
    assert "Write `u [%]` or `u [1]`" in warnings(spectrum)[0]
    fraction = read(three("u [1]", "0.006"))
    assert fraction["total_reflectance_u"].values == pytest.approx(0.006)
    assert warnings(fraction) == warnings(read(three("u [%]", "0.6"))) == []


def test_missing_uncertainties_are_warned_about_with_their_wavelengths(read) -> None:
    spectrum = read(three("u [%]", "0.6").replace("500;30;0.6", "500;30;-9999"))
    assert np.isnan(spectrum["total_reflectance_u"].sel(wavelength=500))
    assert "missing at 1 wavelengths from 500 to 500 nm" in warnings(spectrum)[0]


def test_a_relative_humidity_is_no_unit_of_reflectance(read) -> None:
    text = "# refl. measured at 45 %RH\nnm;R\n" + "".join(f"{nm};0.5\n" for nm in range(400, 701, 20))
    with pytest.raises(InputError, match="ambiguous scale"):
        read(text)
    assert float(read(text, scale="fraction")["total_reflectance"][0]) == 0.5


@pytest.mark.parametrize("line", ["refl. in %", "scale: 0-100 %", "%R", "reflectance 100% white"])
@pytest.mark.parametrize("scale", [None, "percent"])
def test_percent_in_the_header_of_values_below_2_is_doubted_with_and_without_the_key(
    read, line: str, scale: str | None
) -> None:
    text = f"# {line}\nnm;R\n" + "".join(f"{nm};0.5\n" for nm in range(400, 701, 20))
    spectrum = read(text, geometry="sce", scale=scale)
    assert float(spectrum["total_reflectance"][0]) == 0.005
    assert warnings(spectrum) == [
        "sample.csv: no value exceeds 0.5 percent. If they are fractions, set `spectrum.scale: fraction`; if the sample is that dark, "
        "accept this warning."
    ]
    says = "`scale: percent`" if scale else "percent in the header"
    with pytest.raises(InputError, match=f"the scale is wrong.*found {says}, values up to 0.5; accepted: fraction, if"):
        read(text, scale=scale)


@pytest.mark.parametrize("column", [0, 1, 5, -1, "green", "nm", True, 2.0])
def test_an_unknown_column_is_refused_with_the_known_ones(read, column: object) -> None:
    with pytest.raises(InputError, match=r"unknown column.*accepted: 2 to 4, or one of red, blue, std") as refusal:
        read(WIDE, column=column, scale="fraction")
    assert refusal.value.key == "spectrum.column"


def rows(first: int, last: int, step: int = 10, value: float = 50) -> str:
    return HEAD + "".join(f"{nm};{value:g}\n" for nm in range(first, last + 1, step))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (rows(400, 590), "covers 400–590 nm, 590–700 nm is missing"),
        (rows(420, 690), "covers 420–690 nm, 400–420 nm and 690–700 nm are missing"),
        (rows(400, 700, 50), "400–450 nm and 450–500 nm"),
        (
            rows(400, 700).replace("550;50", "550;NaN").replace("540;50", "540;"),
            "covers 400–700 nm, 530–560 nm is missing",
        ),
    ],
)
def test_a_spectrum_without_all_visible_wavelengths_is_refused_with_the_missing_ones(
    read, text: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read(text)


def test_noise_below_zero_is_set_to_zero_and_recorded(read) -> None:
    spectrum = read(rows(400, 700).replace("400;50", "400;-0.3"))
    assert float(spectrum["total_reflectance"][0]) == 0
    assert "1 reflectances between -0.01 and 0 were set to 0" in spectrum.attrs["history"]


def test_a_negative_reflectance_is_refused_by_wavelength(read) -> None:
    with pytest.raises(InputError, match=r"410 nm: negative reflectance; found -0\.05"):
        read(rows(400, 700).replace("410;50", "410;-5"))


def test_a_fluorescent_reflectance_is_refused_unless_allowed(read) -> None:
    text = rows(400, 700).replace("520;50", "520;130")
    with pytest.raises(InputError, match=r"520 nm: reflectance above 1; found 1\.3") as refusal:
        read(text)
    assert refusal.value.key == "spectrum.allow_fluorescent"
    assert read(text, allow_fluorescent=True)["total_reflectance"].max() == 1.3


@pytest.mark.parametrize("title", ["T [%]", "Transmittance (%)", "Absorbance %", "%T"])
def test_another_quantity_than_a_reflectance_is_refused(read, title: str) -> None:
    with pytest.raises(InputError, match="not a reflectance"):
        read(f"nm;{title}\n" + ROWS)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"geometry": "d/8"}, "spectrum.geometry"),
        ({"geometry": None}, "spectrum.geometry"),
        ({"scale": "ppm"}, "spectrum.scale"),
        ({"incidence": 90}, "spectrum.incidence"),
    ],
)
def test_an_invalid_option_is_refused_with_its_key(read, options: dict, key: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(HEAD + ROWS, **options)
    assert refusal.value.key == key


def test_a_header_that_contradicts_the_specular_component_is_warned_about(read) -> None:
    spectrum = read("Mode: specular included\n" + HEAD + ROWS, geometry="sce")
    assert "the header says SCI; `spectrum.geometry: sce` in material.yaml was used" in warnings(spectrum)[0]


BOTH = "nm;R SCI [%];R SCE [%]\n" + "".join(f"{nm};{24 + nm / 100:g};{20 + nm / 100:g}\n" for nm in range(400, 701, 20))


@pytest.mark.parametrize("swapped", [False, True])
def test_a_column_labelled_sce_is_never_read_as_sci(read, swapped: bool) -> None:
    text = BOTH
    if swapped:
        text = "".join(
            f"{line.split(';')[0]};{line.split(';')[2]};{line.split(';')[1]}\n" for line in BOTH.splitlines()
        )
    for geometry, value in (("sci", 0.28), ("sce", 0.24)):
        spectrum = read(text, geometry=geometry)
        assert float(spectrum["total_reflectance"][0]) == pytest.approx(value)
        assert warnings(spectrum) == []
    other = 2 if swapped else 3
    with pytest.raises(
        InputError, match="the column is labelled SCE, and the description says SCI; found column"
    ) as refusal:
        read(text, geometry="sci", column=other)
    assert refusal.value.key == "spectrum.column"
    assert read(text, geometry=None, column=other).attrs["geometry"] == "sce"


def flat(largest: float, digits: int) -> str:
    """Values from half of a largest one to it."""
    return "".join(f"{nm};{largest * nm / 700:.{digits}f}\n" for nm in range(400, 701, 10))


@pytest.mark.parametrize("head", ["nm;R\n", HEAD])
@pytest.mark.parametrize("digits", [2, 3, 5])
@pytest.mark.parametrize("largest", [0.9, 1.07, 1.5])
def test_fractions_called_percent_are_named_as_such(read, head: str, digits: int, largest: float) -> None:
    text = head + flat(largest, digits)
    with pytest.raises(
        InputError, match=r"the scale is wrong.*smooth black surface reflects more than 1\.6"
    ) as refusal:
        read(text, scale="percent")
    assert refusal.value.key == "spectrum.scale"
    (warning,) = warnings(read(text, scale="percent", geometry="sce"))
    assert (
        f"no value exceeds {largest:g} percent. If they are fractions, set `spectrum.scale: fraction`; if the"
        in warning
    )
    assert warnings(read(head + flat(2.1, digits), scale="percent", geometry="sce")) == []


def test_the_least_reflectance_with_the_specular_is_that_of_the_lowest_index(tmp_path: Path) -> None:
    assert specular_reflectance(1.29, 8.0, np.array([550.0]))[0] == pytest.approx(0.016, abs=1e-4)
    path = tmp_path / "sample.csv"
    path.write_text(HEAD + flat(1.9, 2), encoding="utf-8")
    (warning,) = warnings(ingest({"file": path.name, "geometry": "sci"}, path, 1.5))
    assert "no value exceeds 1.9 percent" in warning
    assert "if the specular was excluded, `spectrum.geometry: sce`" in warning


def test_a_real_white_in_fractions_called_percent_is_refused(shared_data: Path) -> None:
    path = shared_data / "spectra" / "munsell_over_unity.csv"
    with pytest.raises(InputError, match=r"the scale is wrong.*values up to 1\.06616; accepted: fraction"):
        read_spectrum(path, scale="percent", geometry="sci")
    messages = warnings(read_spectrum(path, scale="percent", geometry="sce"))
    assert "no value exceeds 1.06616 percent. If they are fractions" in messages[0]


def test_long_lists_of_columns_are_shortened(read) -> None:
    names = ";".join(["nm", *(f"part no. {chr(97 + k % 26)}{chr(97 + k // 26)}" for k in range(300))])
    text = names + "\n" + "".join(f"{nm};" + ";".join(["50"] * 300) + "\n" for nm in range(400, 701, 20))
    assert all(len(text) < 500 for text in warnings(read(text)))
    with pytest.raises(InputError, match="unknown column") as refusal:
        read(text, column="zz")
    assert len(str(refusal.value)) < 400


def test_the_header_states_the_specular_component_if_no_option_does(read) -> None:
    spectrum = read("Mode: specular included\n" + HEAD + ROWS, geometry=None)
    assert (spectrum.attrs["geometry"], spectrum.attrs["theta_i"]) == ("sci", 8)
    assert "geometry sci was read from the file" in spectrum.attrs["history"]
    assert warnings(spectrum) == []


def test_reading_does_not_depend_on_line_order_or_spelling(read, tmp_path: Path) -> None:
    plain = read(HEAD + ROWS)
    shuffled = read(
        "# wavelength [µm]\tR [%]\n" + "".join(f"{nm / 1000:g}\t{20 + nm / 100:g}\n" for nm in range(700, 399, -20))
    )
    np.testing.assert_array_equal(plain["total_reflectance"], shuffled["total_reflectance"])
    np.testing.assert_array_equal(plain["wavelength"], shuffled["wavelength"])


def test_a_read_spectrum_is_stored(read, tmp_path: Path) -> None:
    spectrum = read(HEAD + ROWS, incidence=10)
    assert spectrum.attrs["theta_i"] == 10
    stored = save_dataset(spectrum, tmp_path / "spectrum.nc", stage="spectrum", material="m")
    assert str(tmp_path) not in str(stored.attrs)
