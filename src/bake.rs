//! The program: one line a stage, in the order of the paper's algorithm.

use crate::{
    BakeOptions, Error, Result, Scene, forecast,
    light::LightSet,
    options::{PatchSource, Primary},
    progress::Progress,
    reconstruct::PatchIndex,
    report::Report,
    simplify::{self, Grid},
    trace, transfer,
};

mod exchange;
mod finished;
mod measure;
mod vertices;

pub use finished::{Bake, Irradiance, PatchLight};

use exchange::Exchange;
use measure::{Clock, Work};

/// Bakes a scene.
///
/// # Errors
/// [`Error::Scene`] without geometry or light, [`Error::Backend`] for a tracer that is not there, [`Error::Option`]
/// for options without sense or voxels too small for the memory.
pub fn bake(scene: &Scene, options: &BakeOptions, progress: &dyn Progress) -> Result<Bake> {
    check(scene, options)?;
    let mut clock = Clock::new();

    let grid = Grid::new(scene, options.resolution)?;
    simplify::check_size(scene, &grid, forecast::FRAGMENT_BYTES)?;
    let tracer = trace::build(options.backend, &scene.geometry())?;
    let lights = LightSet::new(scene);
    clock.stop("build");

    let simplified = simplify::simplify(scene, grid, options, &*tracer)?;
    let own = options.patches != PatchSource::Surfels;
    let face_tracer = own.then(|| trace::build(options.backend, &simplified.geometry)).transpose()?;
    simplify::check_rows(simplified.patches.len(), options.rays, forecast::RAY_BYTES)?;
    clock.stop("simplify");

    let lights = if options.primary == Primary::Radiosity { lights.without_surfaces() } else { lights };
    let exchange = Exchange { scene, simplified: &simplified, lights: &lights, tracer: &*tracer, options, progress };
    let (direct, mut visibility) = exchange.direct();
    clock.stop("direct");

    let rows_tracer = face_tracer.as_deref().unwrap_or(&*tracer);
    let lit = exchange.lit(&direct);
    if !lit.contains(&true) {
        return Err(Error::Scene(format!(
            "scene \"{}\": no light reaches any surface; do the lights lie inside objects, or do lamps and walls turn \
             their backs to each other? (try --sides two, or `luxel check`)",
            scene.name
        )));
    }
    let all = !options.skip_unreached;
    let estimate = transfer::estimate(&simplified, rows_tracer, &lit, all, options.rays, options.seed, progress);
    let rows_seconds = clock.stop("form factors");

    let primary = exchange.primary(direct, &estimate.form_factors);
    let (bright, rays) = exchange.bright(&primary, &estimate);
    visibility += rays;
    if rays > 0 {
        clock.stop("bright patches");
    }
    let (secondary, solution) = exchange.secondary(&primary, bright.as_ref(), &estimate.form_factors);
    let light = PatchLight {
        direct: primary.direct,
        indirect: secondary.indirect,
        radiosity: secondary.radiosity,
        reached: estimate.reached,
        known: estimate.visible,
    };
    clock.stop("solve");

    let index = PatchIndex::new(&simplified.patches, grid);
    let mesh = vertices::mesh(scene, &simplified, &light, &index, options, &*tracer);
    clock.stop("split mesh");

    let mut bake = Bake {
        mesh,
        vertices: Irradiance::default(),
        simplified,
        form_factors: estimate.form_factors,
        light,
        report: Report::default(),
        options: options.clone(),
        lights,
        bright: bright.map(|b| b.patches.lights),
        glow: primary.glow,
        smooth: secondary.smooth,
        unsent: secondary.unsent,
        index,
        normals: scene.normals(),
        tracer,
        face_tracer,
    };
    bake.vertices = bake.light(&bake.mesh.samples, options.point_samples, progress);
    clock.stop("vertices");

    let work = Work { solution, row_rays: estimate.rays, visibility, rows_seconds };
    bake.report = measure::report(scene, &bake, work, clock);
    Ok(bake)
}

fn check(scene: &Scene, options: &BakeOptions) -> Result<()> {
    let wrong = |message: String| Err(Error::Option(message));
    if scene.triangles.is_empty() {
        return Err(Error::Scene(format!("scene \"{}\" has no geometry", scene.name)));
    }
    if !(options.rays.is_power_of_two() && (16..=65536).contains(&options.rays)) {
        return wrong(format!("{} rays: it must be a power of two from 16 to 65536", options.rays));
    }
    if !(1..=65536).contains(&options.point_samples) || !(1..=65536).contains(&options.patch_samples) {
        return wrong("shadow samples must be from 1 to 65536".into());
    }
    if !(16..=65536).contains(&options.gather_rays) {
        return wrong(format!("{} gather rays: they must be from 16 to 65536", options.gather_rays));
    }
    if options.target_patches.is_some_and(|n| !(16..=50_000_000).contains(&n)) {
        return wrong("target patches: they must be from 16 to 50000000".into());
    }
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        return wrong(format!("tolerance {} is not between 0 and 1", options.tolerance));
    }
    if !(options.normal_threshold > 0.0 && options.normal_threshold < 90.0) {
        return wrong(format!("normal threshold {} is not between 0 and 90 degrees", options.normal_threshold));
    }
    if !scene.has_light() {
        return Err(Error::Scene(scene.no_light_message()));
    }
    Ok(())
}
