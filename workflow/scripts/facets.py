from brdfpipe import facets, store


def main(input, output, params):
    """Slope density of a surface's facets, measured or assumed."""
    spec, inputs = params["spec"], {name: store.open_dataset(path, name) for name, path in input.items()}
    if inputs:
        result = facets.estimate(inputs["surface"], isotropic=spec.get("isotropic"))
    else:  # of a Beckmann density, the width a is the root mean square slope
        result = facets.analytic(spec["distribution"], a=spec.get("a", spec.get("slope_rms")))
    store.save_dataset(
        result, output["facets"], stage="facets", material=params["material"], inputs=inputs, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
