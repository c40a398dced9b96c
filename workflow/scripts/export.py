from pathlib import Path

from brdfpipe import store
from brdfpipe.exchange.material_export import export


def main(input, output, params):
    """The files of one side of a material, in a format of other programs."""
    bsdf, spec = store.shared_dataset(input["bsdf"], "bsdf"), params["spec"]
    folder = Path(output["export"]).parent / "exports"
    exported = export(bsdf, folder, params["material"], **spec)
    store.save_dataset(
        exported,
        output["export"],
        stage=Path(output["export"]).stem,
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
