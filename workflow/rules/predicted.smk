# From laboratory measurements to a BSDF: surface, facets, index, spectrum, microfacet model; of a clear body, both faces.


use rule stage as surface with:
    input:
        raw=raw("surface"),
    output:
        surface="{material}/surface.nc",


use rule stage as scan with:
    input:
        raw=raw("surface-{scan}"),
    output:
        surface="{material}/surface-{scan}.nc",


use rule stage as facets with:
    input:
        **made("surface", "scan"),
    output:
        facets="{material}/facets.nc",


use rule stage as masking with:
    input:
        **made("surface", "facets"),
    output:
        masking="{material}/masking.nc",


use rule stage as back_surface with:
    input:
        raw=raw("back_surface"),
    output:
        surface="{material}/back_surface.nc",


use rule stage as back_facets with:
    input:
        surface=made("back_surface")["back_surface"],
    output:
        facets="{material}/back_facets.nc",


use rule stage as interior with:
    input:
        raw=raw("interior"),
    output:
        interior="{material}/interior.nc",


use rule stage as index with:
    input:
        raw=raw("index"),
    output:
        index="{material}/index.nc",


use rule stage as spectrum with:
    input:
        **made("index"),
        raw=raw("spectrum"),
    output:
        spectrum="{material}/spectrum.nc",


use rule stage as predicted with:
    input:
        **made("facets", "back_facets", "interior", "index", "spectrum"),
    output:
        predicted="{material}/predicted.nc",
