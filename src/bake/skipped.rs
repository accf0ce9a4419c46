//! What a bake left out.

use std::time::Instant;

use glam::Vec3;

use super::{Bake, measure::Clock};
use crate::{
    light::Spared,
    skip::{Audit, Unwanted, noise},
    trace::{Hit, RayBatch},
    transfer::{self, Emitter, RowPoints},
};

/// What the stages found that spares work.
#[derive(Default)]
pub(super) struct Found {
    /// Materials with textures of one colour.
    pub plain: Vec<u32>,
    /// Patches that no surface lies before, and their rays.
    pub outer: Vec<bool>,
    pub clear: u64,
    /// Unreached patches that see out of the scene.
    pub outside: Vec<bool>,
    /// Patches with shorter rows.
    pub few: Vec<bool>,
    /// With `only`: patches of the wanted meshes.
    pub own: Option<Vec<bool>>,
    /// Shadow rays of the patches from the lights, and all that were spared.
    pub shadows: (u64, Spared),
    /// Lamps that reach nothing, and rays that were cast to them.
    pub dark: (usize, u64),
    /// Distinct channels.
    pub bands: usize,
}

/// Adds up what was found. `row_rays` and `rows_seconds` are those of the form factors.
pub(super) fn audit(
    scene: &crate::Scene,
    bake: &Bake,
    found: Found,
    row_rays: u64,
    points: &RowPoints,
    clock: &Clock,
) -> Audit {
    if !bake.foresight.on {
        return Audit { bands: (3, 0.0), ..Audit::default() };
    }
    let (patches, light, f) = (bake.patches(), &bake.light, &bake.form_factors);
    let n = patches.len();
    let unreached = |i: &usize| !light.reached[*i] && found.own.is_none();
    let count = |which: &dyn Fn(usize) -> bool| (0..n).filter(unreached).filter(|&i| which(i)).count();
    let outer = |i: usize| found.outer.get(i).is_some_and(|&outer| outer);
    let rate = |seconds: f64, rays: u64| if rays > 0 { seconds / rays as f64 } else { 0.0 };

    let (vertex_shadows, at_vertices) = bake.foresight.take();
    let (visibility, level) = bake.foresight.level.rays();
    let vertex_rays = vertex_shadows + visibility;
    let direct: f64 = bake.vertices.direct.iter().map(|e| e.element_sum() as f64 / 3.0).sum();
    let sky = bake.lights.even_sky().unwrap_or(0.0);
    let material = |i: usize| {
        let t = bake.simplified.fragments.triangle[(patches.members(i)[0] >> 1) as usize];
        scene.triangles.get(t as usize).map(|t| t.material)
    };
    Audit {
        plain_patches: (0..n).filter(|&i| material(i).is_some_and(|m| found.plain.contains(&m))).count(),
        plain_materials: found.plain.len(),
        outer: found.outer.iter().filter(|&&o| o).count(),
        outer_rays: found.clear,
        unlit: [
            count(&|i| found.outside[i] && !outer(i)),
            count(&|i| !found.outside[i] && light.known[i] && !outer(i)),
            count(&|i| !light.known[i]),
        ],
        row_rays: [bake.options.rays as u64, points.probe_rays() as u64],
        seconds: [
            rate(clock.seconds("form factors"), row_rays),
            rate(clock.seconds("direct"), found.shadows.0),
            rate(clock.seconds("vertices"), vertex_rays),
        ],
        clear_seconds: clear_seconds(bake, points, &found.outer),
        shadows: [found.shadows.1, at_vertices],
        dark_lamps: found.dark,
        sky_loss: if direct > 0.0 { at_vertices.sky_loss as f64 * 1e-9 * sky / direct } else { 0.0 },
        level,
        bands: (found.bands, clock.seconds("solve")),
        only: found.own.as_ref().map(|own| {
            let black = |i: usize| patches.albedo[i] == Vec3::ZERO;
            let without =
                |black_ones: bool| (0..n).filter(|&i| !f.has_row(i) && !outer(i) && black(i) == black_ones).count();
            let few = (0..n).filter(|&i| found.few[i] && f.has_row(i));
            let saved = |i: usize| (bake.options.rays as u64).saturating_sub(f.rays(i).0 as u64);
            let irradiance = |i: usize| light.direct[i] + light.indirect[i];
            let triangles = &bake.simplified.fragments.triangle;
            let wanted: std::collections::HashSet<u32> = bake.mesh.source.iter().copied().collect();
            let kept = triangles.iter().filter(|t| wanted.contains(t)).count().max(1) as u64;
            Unwanted {
                apart: without(false),
                black: without(true),
                few: few.fold((0, 0), |(count, rays), i| (count + 1, rays + saved(i))),
                noise: noise(patches, f, irradiance, &light.radiosity, own, &found.few),
                vertex_rays: vertex_rays * (triangles.len() as u64 - kept) / kept,
            }
        }),
    }
}

/// Patches whose rays are cast to see how long they take.
const SAMPLE: usize = 64;

/// Seconds a ray from patches that nothing lies before, on all threads: such rays are fast, so they are timed apart.
fn clear_seconds(bake: &Bake, points: &RowPoints, outer: &[bool]) -> f64 {
    let outer: Vec<u32> = (0..outer.len() as u32).filter(|&i| outer[i as usize]).collect();
    if outer.is_empty() {
        return 0.0;
    }
    let (mut emitter, mut rays, mut hits, mut cast) = (Emitter::default(), RayBatch::default(), Vec::new(), 0);
    let begun = Instant::now();
    for &i in outer.iter().step_by(outer.len().div_ceil(SAMPLE)) {
        transfer::row_rays(&bake.simplified, points.rows(), i, bake.options.seed, 0, &mut emitter, &mut rays);
        hits.resize(rays.len(), Hit::NONE);
        bake.patch_tracer().closest_hits(&rays, &mut hits);
        cast += rays.len();
    }
    begun.elapsed().as_secs_f64() / (cast * rayon::current_num_threads()) as f64
}
