from pathlib import Path

from brdfpipe import store
from brdfpipe.report.catalogue.page import catalogue_page
from brdfpipe.report.catalogue.rows import catalogue_csv, combine, lock


def main(input, output, params):
    """The catalogue: page, table, dataset and the digests of everything in it."""
    rows = [store.open_dataset(path, "catalogue") for path in input.get("summaries", [])]
    spec, pages = params["spec"], {Path(page).parent.name for page in input.get("pages", [])}
    catalogue = store.save_dataset(
        combine(rows),
        output["dataset"],
        stage="catalogue",
        material="catalogue",
        inputs={row["material"].values[0]: row for row in rows},
        parameters={name: value for name, value in spec.items() if name not in ("others", "changes")},
    )
    failures = spec["failures"]
    store.write_text(output["csv"], catalogue_csv(catalogue, failures))
    store.write_text(output["lock"], lock(catalogue))
    shown = {"scene": spec.get("scene"), "others": spec.get("others", []), "changes": spec.get("changes", "")}
    store.write_text(output["page"], catalogue_page(catalogue, failures, pages=pages, **shown))


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
