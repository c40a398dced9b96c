from brdfpipe import store
from brdfpipe.bsdf.reference_solution import build


def main(input, output, params):
    """The BSDF of the reference solution that holds on the height map."""
    spec, inputs = params["spec"], {name: store.open_dataset(path, name) for name, path in input.items()}
    spectrum = inputs.get("spectrum") if spec["diffuse"] != "none" else None
    bsdf = build(inputs["surface"], index=inputs["index"], spectrum=spectrum)
    store.save_dataset(
        bsdf, output["reference"], stage="reference", material=params["material"], inputs=inputs, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
