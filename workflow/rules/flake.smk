# From colours at several geometries to a BSDF: effect pigments.


use rule stage as multiangle with:
    input:
        raw=raw("multiangle"),
    output:
        multiangle="{material}/multiangle.nc",


use rule stage as flake with:
    input:
        **made("multiangle"),
    output:
        flake="{material}/flake.nc",
