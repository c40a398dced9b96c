from brdfpipe import store
from brdfpipe.bsdf.predictions import PREDICTIONS
from brdfpipe.report import reading
from brdfpipe.report.material.page import material_page


def main(input, output, params):
    """The page of a material."""
    spec = params["spec"]
    with reading.opened(dict(input.items()), evaluated=("bsdf", *PREDICTIONS)) as datasets:
        files = reading.relative(dict(input.items()), to=output["page"])
        page = material_page(datasets, files=files, **spec)
    store.write_text(output["page"], page)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
