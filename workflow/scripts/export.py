from brdfpipe import store
from brdfpipe.exchange.registry import FORMATS


def main(input, output, params):
    """The files of one side of a material, in a format of other programs."""
    format, side = FORMATS[params["spec"]["format"]], params["spec"]["side"]
    stem = output["file"].removesuffix(format.suffixes(side)[0])
    format.write(store.shared_dataset(input["bsdf"], "bsdf"), stem, side)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
