from brdfpipe import store


def main(input, output, params):
    """The BSDF of the best route of the material: measured, else of flakes, else predicted."""
    spec, inputs = params["spec"], {name: store.open_dataset(path, "bsdf") for name, path in input.items()}
    source = spec["route"]
    if source == "predicted":
        source = next(name for name in ("reference", "wave", "predicted") if name in inputs)
    bsdf = inputs[source].assign_attrs(route=spec["route"])
    store.save_dataset(bsdf, output["bsdf"], stage="bsdf", material=params["material"], inputs=inputs, parameters=spec)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
