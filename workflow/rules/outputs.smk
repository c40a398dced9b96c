# From a BSDF to its checks, appearance, table, fit, exports and report; `scene` is empty or the folder of a scene other than the default.


use rule stage_template as bsdf with:
    input:
        **results_of(
            "predicted",
            "wave",
            "sheet",
            "coated",
            "reference",
            "flake",
            "imported",
            "measured",
            "uncertainty",
            "flake_uncertainty",
            "sheet_uncertainty",
            "coated_uncertainty",
        ),
    output:
        bsdf="{material}/bsdf.nc",


use rule stage_template as nominal_bsdf with:
    input:
        unpack(pipeline.source_of_bsdf),
    output:
        bsdf="{material}/nominal_bsdf.nc",


use rule stage_template as plan with:
    input:
        **results_of("surface", "facets", "psd", "index", "spectrum"),
        experience=pipeline.experience,
    output:
        plan="{scene}{material}/plan.nc",


use rule stage_template as planned with:
    input:
        **results_of("surface", "facets", "psd", "index", "spectrum", "plan"),
    output:
        bsdf="{scene}{material}/planned.nc",


use rule stage_template as checks with:
    input:
        **results_of("bsdf", "spectrum"),
    output:
        checks="{scene}{material}/checks.nc",


use rule stage_template as appearance with:
    input:
        **results_of("bsdf"),
    output:
        appearance="{scene}{material}/appearance.nc",


use rule stage_template as readings with:
    input:
        **results_of("bsdf", "predicted", "facets", "psd", "index", "spectrum"),
    output:
        readings="{scene}{material}/readings.nc",
        csv="{scene}{material}/exports/{material}.readings.csv",


use rule stage_template as preview with:
    input:
        **results_of("bsdf"),
    output:
        preview="{scene}{material}/preview.nc",
        png="{scene}{material}/preview.png",


use rule stage_template as table with:
    input:
        **results_of("bsdf"),
    output:
        table="{scene}{material}/table.nc",


use rule stage_template as lambert_gauss with:
    input:
        **results_of("bsdf"),
    output:
        lambert_gauss="{scene}{material}/lambert_gauss.nc",
        csv="{scene}{material}/exports/{material}.lambert_gauss.csv",


use rule stage_template as texture with:
    input:
        **results_of("surface", "facets"),
    output:
        texture="{scene}{material}/texture.nc",


use rule stage_template as picture_texture with:
    input:
        **results_of("bsdf"),
        pictures=pipeline.raw_files("texture"),
    output:
        texture="{scene}{material}/picture_texture.nc",


use rule stage_template as unresolved with:
    input:
        **results_of("texture", "index", "spectrum", "bsdf"),
    output:
        unresolved="{scene}{material}/unresolved.nc",


use rule stage_template as texture_preview with:
    input:
        **results_of("bsdf", "texture", "unresolved", "picture_texture"),
    output:
        preview="{scene}{material}/texture_preview.nc",


# A rule for each format, and each side of the material with separate files.
for export in EXPORTS:

    rule:
        name:
            export.name
        input:
            **results_of("bsdf"),
        output:
            export=export.result,
        run:
            pipeline.run(rule, wildcards, input, output, params)


use rule stage_template as report with:
    input:
        unpack(pipeline.reported),
    output:
        page="{scene}{material}/report.html",


use rule stage_template as summary with:
    input:
        unpack(pipeline.reported),
    output:
        summary="{scene}{material}/summary.nc",
