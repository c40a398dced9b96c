from brdfpipe import store
from brdfpipe.bsdf import lambert_gauss, microfacet


def main(input, output, params):
    """The BRDF that facets, index and spectrum predict; of a colour alone, a Lambertian one."""
    spec, inputs = params["spec"], {name: store.open_dataset(path, name) for name, path in input.items()}
    bsdf = microfacet.build(**inputs, **spec) if "facets" in inputs else lambert_gauss.lambertian(inputs["spectrum"])
    store.save_dataset(
        bsdf, output["predicted"], stage="predicted", material=params["material"], inputs=inputs, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
