from brdfpipe import store
from brdfpipe.exchange import astm
from brdfpipe.exchange import sidecar_tables as companions


def main(input, output, params):
    """The transmitting side of the table as an ASTM file, and the total transmittance beside it."""
    bsdf = store.open_dataset(input["bsdf"], "bsdf")
    astm.write_transmission(store.open_dataset(input["table"], "bsdf"), output["astm"], model=bsdf)
    companions.write_total_transmittance(bsdf, output["total_transmittance"])


if __name__ == "__main__":
    from brdfpipe.jobs.stage import by_hand

    by_hand(main)
