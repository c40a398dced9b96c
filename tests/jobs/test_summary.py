"""The summary of a build names the reason of every verdict of fail."""

from pathlib import Path

from brdfpipe.jobs.summary import Summary, read_rows


def test_a_verdict_is_read_with_all_its_reasons(tmp_path: Path) -> None:
    lines = (
        "material,status,verdict,verdict_text,refused_exports",
        "m,built,fail,table: differs by 40 %; roughness against wavelength (550 nm): g = 0.03,",
        "n,built,pass,,export gltf not written: a lay",
        "o,failed,,,",
    )
    (tmp_path / "catalogue.csv").write_text("\n".join(lines) + "\n")
    assert read_rows([tmp_path], ["m", "n", "o", "p"]) == {
        "m": ("fail", "table: differs by 40 %; roughness against wavelength (550 nm): g = 0.03", ""),
        "n": ("pass", "", "export gltf not written: a lay"),
    }


def test_without_a_table_no_verdict_is_known(tmp_path: Path) -> None:
    assert read_rows([tmp_path], ["m"]) == {}


def test_no_page_is_named_where_the_scene_makes_none() -> None:
    summary = Summary(("a",), (), {}, 1, None, 1.0)
    assert "Open" not in summary.text
    assert summary.plain["page"] is None


def test_a_refused_export_is_named_and_makes_a_build_fail() -> None:
    summary = Summary(
        ("a", "b"),
        (),
        {},
        1,
        None,
        1.0,
        refused_exports={"a": "export gltf not written: a lay", "b": "export mdl not written: a lay"},
    )
    assert "  a: built, but export gltf not written: a lay" in summary.text
    assert summary.text.count("take them out of `exports`") == 1
    assert summary.has_failed()
    assert not Summary(("a", "b"), (), {}, 1, None, 1.0).has_failed()
