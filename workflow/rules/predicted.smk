# From laboratory measurements to a BSDF: surface, facets, index, spectrum, microfacet model; of a clear or coated body, both faces.


use rule stage_template as surface with:
    input:
        raw=raw_file("surface"),
        picture=raw_file("mask"),
    output:
        surface="{material}/surface.nc",


use rule stage_template as scan with:
    input:
        raw=raw_file("surface-{scan}"),
    output:
        surface="{material}/surface-{scan}.nc",


use rule stage_template as facets with:
    input:
        **results_of("surface", "scan"),
    output:
        facets="{material}/facets.nc",


use rule stage_template as gloss_facets with:
    input:
        **results_of("index", "spectrum"),
    output:
        facets="{material}/gloss_facets.nc",


use rule stage_template as psd with:
    input:
        **results_of("surface", "scan"),
    output:
        psd="{material}/psd.nc",


use rule stage_template as visibility with:
    input:
        **results_of("surface", "facets"),
    output:
        visibility="{material}/visibility.nc",


use rule stage_template as back_surface with:
    input:
        raw=raw_file("back_surface"),
    output:
        surface="{material}/back_surface.nc",


use rule stage_template as back_facets with:
    input:
        **results_of(surface="back_surface"),
    output:
        facets="{material}/back_facets.nc",


use rule stage_template as back_psd with:
    input:
        **results_of(surface="back_surface"),
    output:
        psd="{material}/back_psd.nc",


use rule stage_template as base_surface with:
    input:
        raw=raw_file("base_surface"),
    output:
        surface="{material}/base_surface.nc",


use rule stage_template as base_facets with:
    input:
        **results_of(surface="base_surface"),
    output:
        facets="{material}/base_facets.nc",


use rule stage_template as base_index with:
    input:
        raw=raw_file("base_index"),
    output:
        index="{material}/base_index.nc",


use rule stage_template as interior with:
    input:
        raw=raw_file("interior"),
    output:
        interior="{material}/interior.nc",


use rule stage_template as index with:
    input:
        raw=raw_file("index"),
    output:
        index="{material}/index.nc",


use rule stage_template as spectrum with:
    input:
        **results_of("index"),
        raw=raw_file("spectrum"),
        excluded=raw_file("spectrum_sce"),
    output:
        spectrum="{material}/spectrum.nc",


use rule stage_template as interreflection with:
    input:
        **results_of("surface", "facets", "index", "spectrum"),
    output:
        interreflection="{material}/interreflection.nc",


use rule stage_template as predicted with:
    input:
        **results_of(
            "facets",
            "psd",
            "visibility",
            "interreflection",
            "index",
            "spectrum",
        ),
    output:
        predicted="{material}/predicted.nc",


use rule stage_template as sheet with:
    input:
        **results_of(
            "facets",
            "psd",
            "back_facets",
            "back_psd",
            "interior",
            "index",
        ),
    output:
        sheet="{material}/sheet.nc",


use rule stage_template as coated with:
    input:
        **results_of(
            "facets",
            "base_facets",
            "interior",
            "index",
            "base_index",
            "spectrum",
        ),
    output:
        coated="{material}/coated.nc",


use rule stage_template as wave with:
    input:
        **results_of("predicted", "psd", "facets", "visibility", "index", "spectrum"),
    output:
        wave="{material}/wave.nc",


use rule stage_template as reference with:
    input:
        **results_of("surface", "index", "spectrum"),
    output:
        reference="{material}/reference.nc",


use rule stage_template as model_error with:
    input:
        **results_of("surface", "scan", "facets", "predicted", "wave"),
    output:
        model_error="{material}/model_error.nc",


use rule stage_template as uncertainty with:
    input:
        **results_of(
            "predicted",
            "wave",
            "facets",
            "psd",
            "index",
            "spectrum",
            "model_error",
        ),
    output:
        uncertainty="{material}/uncertainty.nc",


use rule stage_template as sheet_uncertainty with:
    input:
        **results_of(
            "sheet",
            "facets",
            "psd",
            "back_facets",
            "back_psd",
            "interior",
            "index",
        ),
    output:
        sheet_uncertainty="{material}/sheet_uncertainty.nc",


use rule stage_template as coated_uncertainty with:
    input:
        **results_of(
            "coated",
            "facets",
            "base_facets",
            "interior",
            "index",
            "base_index",
            "spectrum",
        ),
    output:
        coated_uncertainty="{material}/coated_uncertainty.nc",
