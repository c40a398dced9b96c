from brdfpipe import store
from brdfpipe.facets.analytic_distributions import analytic, flat
from brdfpipe.facets.estimation import estimate


def main(input, output, params):
    """Slope density of a surface's facets, measured in one scan or several, or assumed."""
    spec, paths = params["spec"], [input["surface"], *input.get("scan", [])] if "surface" in input else []
    scans = {f"surface-{k}": store.open_dataset(path, "surface") for k, path in enumerate(paths, start=1)}
    if scans:
        result = estimate(list(scans.values()), **spec)
    elif spec["distribution"] == "flat":
        result = flat()
    else:  # of a Beckmann density, the width a is the root mean square slope
        result = analytic(spec["distribution"], a=spec.get("a", spec.get("slope_rms")))
    store.save_dataset(
        result, output["facets"], stage="facets", material=params["material"], inputs=scans, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
