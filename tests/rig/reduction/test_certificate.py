"""Certificates of etalons: their values, and refusals."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.rig.reduction.certificate import Certificate, CertificateError

PLAIN = 'id: SRM-1\nvalid_until: "2027-06-30"\nreflectance_factor: 0.95\n'
TABLE = "# of the laboratory\nwavelength,reflectance_factor,u\n400,0.90,0.01\n500,0.94,0.006\n700,0.96,0.004\n"


def load(folder, text=PLAIN, table=None):
    (folder / "certificate.yaml").write_text(text)
    if table is not None:
        (folder / "white.csv").write_text(table)
    return Certificate.load(folder / "certificate.yaml")


def test_one_number_holds_at_every_wavelength_and_angle(tmp_path):
    certificate = load(tmp_path)
    brdf, u = certificate.brdf(np.array([390.0, 730.0]), np.array([0.0, 40.0, 89.0]))
    assert brdf == pytest.approx(np.full((2, 3), 0.95 / np.pi))
    assert u == pytest.approx([0.005, 0.005])
    assert certificate.valid_until == date(2027, 6, 30)


def test_a_shape_has_its_stated_uncertainty_and_beyond_the_last_angle_that_of_diffuse_standards(tmp_path):
    certificate = load(tmp_path, PLAIN + "angles: [[0, 1], [30, 0.99, 0.002], [60, 0.95, 0.004]]\n")
    assert certificate.shape_u_at(np.array([0.0, 15.0, 30.0, 45.0, 60.0])) == pytest.approx(
        [0, 0.001, 0.002, 0.003, 0.004]
    )
    # 5 % at 60 degree and growing with the square of the angle, from the last one that is stated.
    beyond = np.hypot(0.004, 0.05 * (80**2 - 60**2) / 60**2)
    assert certificate.shape_u_at(np.array([80.0])) == pytest.approx(beyond)
    assert load(tmp_path).shape_u_at(np.array([0.0, 30.0, 60.0])) == pytest.approx([0, 0.0125, 0.05])


def test_ratios_without_an_uncertainty_have_that_of_the_factor(tmp_path):
    certificate = load(tmp_path, PLAIN + "u: 0.007\nangles: [[0, 1], [30, 0.99], [60, 0.95, 0]]\n")
    assert certificate.shape_u_at(np.array([0.0, 30.0, 60.0])) == pytest.approx([0, 0.007, 0])


def test_a_table_and_angles_are_interpolated_linearly(tmp_path):
    text = 'id: SRM-2\nvalid_until: "2027-06-30"\nreflectance_factor: {file: white.csv}\nangles: [[0, 2], [30, 1.9], [60, 1.5]]\n'
    brdf, u = load(tmp_path, text, TABLE).brdf(np.array([450.0, 600.0]), np.array([0.0, 15.0, 45.0, 80.0]))
    height = np.array([0.92, 0.95]) / np.pi
    # The angles are a ratio to 0 degree; beyond the last one it stays.
    assert brdf == pytest.approx(height[:, None] * np.array([1.0, 0.975, 0.85, 0.75]))
    assert u == pytest.approx([0.008, 0.005])


def test_wavelengths_beyond_the_table_are_refused(tmp_path):
    text = 'id: SRM-2\nvalid_until: "2027-06-30"\nreflectance_factor: {file: white.csv}\n'
    certificate = load(tmp_path, text, TABLE)
    with pytest.raises(CertificateError, match=r"covers 400 to 700 nm, the etalon was measured from 390 to 650 nm"):
        certificate.brdf(np.array([390.0, 650.0]), np.zeros(1))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PLAIN.replace("2027-06-30", "30.6.2027"), ["valid_until", "not a date", "30.6.2027"]),
        (PLAIN.replace("0.95", "0"), ["reflectance_factor"]),
        (PLAIN + "angles: [[5, 1], [30, 0.9]]\n", ["angles", "increase from 0"]),
        (PLAIN + "angles: [[0, 1], [30, 0.9], [30, 0.8]]\n", ["angles", "increase from 0"]),
        (PLAIN + "angles: [[0, 0], [30, 0.9]]\n", ["angles", "ratio at 0 degree"]),
        (PLAIN + "angles: [[0, 1], [30, 0.9, 2]]\n", ["angles", "0 to 1"]),
        (PLAIN + "angles: [[0, 1], [30, 0.9, 0.1, 3]]\n", ["angles"]),
        (PLAIN + "colour: white\n", ["colour"]),
        (PLAIN.replace("0.95", "{file: white.csv}"), ["white.csv"]),
        (PLAIN.replace("0.95", "{file: ../white.csv}"), ["reflectance_factor.file"]),
    ],
)
def test_an_invalid_certificate_is_refused_with_its_key(tmp_path, text, words):
    with pytest.raises(InputError) as refusal:
        load(tmp_path, text)
    for word in words:
        assert word in str(refusal.value)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", ["titles"]),
        ("wavelength,reflectance\n400,0.9\n", ["line 1", "titles", "reflectance_factor"]),
        (TABLE.replace("500,0.94,0.006", "500,0.94"), ["line 4"]),
        (TABLE.replace("0.94", "bright"), ["line 4", "bright"]),
        (TABLE.replace("0.94", "nan"), ["line 4"]),
        (TABLE.replace("0.94", "9.4"), ["line 4"]),
        (TABLE.replace("500", "300"), ["do not increase"]),
        ("wavelength,reflectance_factor,u\n400,0.9,0.01\n", ["two lines or more"]),
    ],
)
def test_an_invalid_table_is_refused_with_its_line(tmp_path, table, words):
    text = PLAIN.replace("0.95", "{file: white.csv}")
    with pytest.raises(InputError) as refusal:
        load(tmp_path, text, table)
    assert "white.csv" in str(refusal.value)
    for word in words:
        assert word in str(refusal.value)


def test_a_binary_table_is_refused(tmp_path):
    (tmp_path / "white.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        load(tmp_path, PLAIN.replace("0.95", "{file: white.csv}"))
