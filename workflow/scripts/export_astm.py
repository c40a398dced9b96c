from brdfpipe import store
from brdfpipe.exchange import astm
from brdfpipe.exchange import sidecar_tables as companions


def main(input, output, params):
    """The table as an ASTM E1392 file, and the total reflectance beside it."""
    bsdf = store.open_dataset(input["bsdf"], "bsdf")
    astm.write(store.open_dataset(input["table"], "bsdf"), output["astm"], model=bsdf)
    companions.write_total_reflectance(bsdf, output["total_reflectance"])


if __name__ == "__main__":
    from brdfpipe.jobs.stage import by_hand

    by_hand(main)
