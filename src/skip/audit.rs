//! The list of what was left out.

use crate::{light::Spared, report::Skipped};

/// Probe rays of a patch that nothing lit met.
const PROBE: f64 = 64.0;
/// Time of the solver with one and with two channels, as a share of that with three: entries are decoded all the same.
const PRODUCT: [f64; 2] = [0.85, 0.93];

/// What a bake left out, in patches, points and rays, and what its rays took.
#[derive(Clone, Debug, Default)]
pub struct Audit {
    /// Textures of one colour: patches of materials that name them.
    pub plain_patches: usize,
    /// Materials with textures of one colour.
    pub plain_materials: usize,
    /// Patches that no surface lies before.
    pub outer: usize,
    /// Their rows' and probes' rays.
    pub outer_rays: u64,
    /// Unreached patches that see out of the scene; that lie in sealed air; that are hidden in or behind objects.
    pub unlit: [usize; 3],
    /// Form-factor rays a patch, and those that are cast to probe one.
    pub row_rays: [u64; 2],
    /// Seconds a form-factor ray; a shadow ray of a patch; a ray of a vertex.
    pub seconds: [f64; 3],
    /// Seconds a ray that meets nothing.
    pub clear_seconds: f64,
    /// Shadow rays of the patches and of the vertices that were not cast.
    pub shadows: [Spared; 2],
    /// Lamps that reach nothing, and rays that were cast to them.
    pub dark_lamps: (usize, u64),
    /// Largest expected loss of direct light by sky rays that were not cast, relative to all.
    pub sky_loss: f64,
    /// Visibility rays of vertices that were not cast.
    pub level: u64,
    /// Distinct channels, and the seconds of the solver.
    pub bands: (usize, f64),
    /// What was not wanted.
    pub only: Option<Unwanted>,
}

/// What `--only` left out.
#[derive(Clone, Debug, Default)]
pub struct Unwanted {
    /// Patches without a row: nothing that the wanted ones see, directly or not, sees them.
    pub apart: usize,
    /// Black patches without a row.
    pub black: usize,
    /// Patches with shorter rows, and the rays that this saved.
    pub few: (usize, u64),
    /// Relative standard error that this causes.
    pub noise: f64,
    /// Rays of the vertices of other meshes, about.
    pub vertex_rays: u64,
}

/// The list of a bake, without entries that saved nothing.
pub fn list(a: &Audit) -> Vec<Skipped> {
    let [per_row, per_patch, per_vertex] = a.seconds;
    let [at_patches, at_vertices] = &a.shadows;
    let entry = |what: &str, patches: usize, rays: u64, seconds: Option<f64>, bound: Option<f64>, error: String| {
        Skipped { what: what.into(), patches, rays, seconds, bound, error }
    };
    let rows = |rays: u64| Some(rays as f64 * per_row);
    let shadows = |patch: u64, vertex: u64| Some(patch as f64 * per_patch + vertex as f64 * per_vertex);
    let exact = |text: &str| text.to_string();
    let mut entries = Vec::new();

    let clear = at_patches.clear + at_vertices.clear;
    let seconds = Some((a.outer_rays + clear) as f64 * a.clear_seconds);
    let error = exact("none: no vertex of the scene lies before them, so rays meet nothing");
    entries.push(entry("outer shells", a.outer, a.outer_rays + clear, seconds, Some(0.0), error));

    let [row, probe] = a.row_rays;
    let asked = row.min(PROBE as u64);
    let expected = 1.0 / (std::f64::consts::E * PROBE);
    let unlit = |patches: usize| {
        let rays = patches as u64 * row.saturating_sub(probe);
        (patches, rays, rows(rays))
    };
    for (what, patches) in
        ["air outside that no light reaches", "sealed air that no light reaches"].into_iter().zip(a.unlit)
    {
        let (patches, rays, seconds) = unlit(patches);
        let error = format!(
            "none of {asked} probe rays of each met a lit patch, and no ray of a lit patch met it; bound: of the \
             radiosity that may hide"
        );
        entries.push(entry(what, patches, rays, seconds, Some(expected), error));
    }
    let (patches, rays, seconds) = unlit(a.unlit[2]);
    let error = format!("all of {asked} probe rays of each started inside or behind an object: nobody sees it");
    entries.push(entry("surfaces hidden in objects", patches, rays, seconds, None, error));

    let (p, v) = (at_patches.away, at_vertices.away);
    let error = exact("none: the lamp is behind, out of its cone or range; one ray a pair is counted");
    entries.push(entry("shadow rays to lamps that face away", 0, p + v, shadows(p, v), Some(0.0), error));

    let (p, v) = (at_patches.black_sky, at_vertices.black_sky);
    entries.push(entry("sky rays without sky", 0, p + v, shadows(p, v), Some(0.0), exact("none: they carry nothing")));

    let rays = at_vertices.no_sky + at_vertices.all_sky;
    let error = exact(
        "512 or more rays of the patches around a point agree that it sees no sky, or only sky; bound: expected loss of \
         direct light, 1 / (e n) of an open sky at each such point",
    );
    entries.push(entry("sky rays of known answer", 0, rays, shadows(0, rays), Some(a.sky_loss), error));

    let (lamps, rays) = (a.dark_lamps, at_vertices.dark_lamps);
    let error = format!("none of {} shadow rays of patches reached the {} lamps", lamps.1, lamps.0);
    let bound = Some(1.0 / (std::f64::consts::E * lamps.1.max(1) as f64));
    entries.push(entry("lights that reach nothing", 0, rays, shadows(0, rays), bound, error));

    let error = exact("none: all surface near lies in one plane; but for dust that clipping leaves out");
    entries.push(entry("visibility rays along planes", 0, a.level, shadows(0, a.level), Some(0.0), error));

    if a.bands.0 < 3 {
        let seconds = PRODUCT.get(a.bands.0 - 1).map(|share| a.bands.1 * (1.0 / share - 1.0));
        let what = format!("{} of 3 channels that equal another", 3 - a.bands.0);
        entries.push(Skipped { seconds, ..entry(&what, 0, 0, None, Some(0.0), exact("none: the same bits")) });
    }
    if a.plain_materials > 0 {
        let what = format!("textures of one colour, {} materials", a.plain_materials);
        let error = exact("rounding of sums of equal samples");
        entries.push(entry(&what, a.plain_patches, 0, None, Some(1e-6), error));
    }
    if let Some(only) = &a.only {
        let rays = only.apart as u64 * row;
        let error = exact("no ray of a patch that matters met them: they add nothing to what was computed");
        entries.push(entry("patches apart from the wanted meshes", only.apart, rays, rows(rays), Some(0.0), error));
        let rays = only.black as u64 * row;
        let error = exact("none: they reflect nothing, and nobody asked for their light");
        entries.push(entry("black surfaces nobody asked for", only.black, rays, rows(rays), Some(0.0), error));
        let (patches, rays) = only.few;
        let error = exact("shorter rows; bound: standard error of the wanted mean irradiance, by importance");
        entries.push(entry("rays that matter little to them", patches, rays, rows(rays), Some(only.noise), error));
        let rays = only.vertex_rays;
        let error = exact("none: not asked for");
        entries.push(entry("vertices of other meshes", 0, rays, shadows(0, rays), Some(0.0), error));
    }
    let saves = |s: &Skipped| s.patches > 0 || s.rays > 0 || s.seconds.is_some_and(|s| s > 0.0);
    entries.into_iter().filter(saves).collect()
}
