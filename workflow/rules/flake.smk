# From colours at several geometries to a BSDF: effect pigments.


use rule stage_template as multiangle with:
    input:
        raw=raw_file("multiangle"),
    output:
        multiangle="{material}/multiangle.nc",


use rule stage_template as flake with:
    input:
        **results_of("multiangle"),
    output:
        flake="{material}/flake.nc",


use rule stage_template as flake_uncertainty with:
    input:
        **results_of("multiangle", "flake"),
    output:
        flake_uncertainty="{material}/flake_uncertainty.nc",
