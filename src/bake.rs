//! The program: one line a stage, in the order of the paper's algorithm.

use std::{borrow::Cow, time::Instant};

use crate::{
    BakeOptions, Error, Result, Scene, estimate, forecast,
    light::{Census, LampPower, LightSet},
    options::{PatchSource, Primary},
    progress::Progress,
    reconstruct::PatchIndex,
    report::Report,
    simplify::{self, Grid},
    skip::{self, Foresight, Wanted},
    trace::{self, Hit},
};

mod exchange;
mod finished;
mod measure;
mod needs;
mod relit;
mod skipped;
mod vertices;

pub use finished::{Bake, Irradiance, PatchLight};

use exchange::Exchange;
use measure::{Clock, Work};
use needs::Needs;
use skipped::Found;

/// Bakes a scene.
///
/// # Errors
/// [`Error::Scene`] without geometry or light, [`Error::Backend`] for a tracer that is not there, [`Error::Option`]
/// for options without sense or voxels too small for the memory.
pub fn bake(scene: &Scene, options: &BakeOptions, progress: &dyn Progress) -> Result<Bake> {
    bake_until(scene, options, progress, None)
}

/// As [`bake`]; gives up at the end of the first stage that ends after `deadline`, if it is not the last.
pub(crate) fn bake_until(
    scene: &Scene,
    options: &BakeOptions,
    progress: &dyn Progress,
    deadline: Option<Instant>,
) -> Result<Bake> {
    check(scene, options)?;
    let only = Wanted::new(scene, &options.only)?;
    let mut clock = Clock::new(deadline);
    let (scene, plain) = if options.skip { skip::plain(scene) } else { (Cow::Borrowed(scene), Vec::new()) };
    let scene = &*scene;

    let grid = Grid::new(scene, options.resolution)?;
    simplify::check_size(scene, &grid, forecast::FRAGMENT_BYTES)?;
    let geometry = scene.geometry();
    let tracer = trace::build(options.backend, &geometry)?;
    let mut foresight = Foresight::new(options.skip, &geometry);
    let lights = LightSet::new(scene);
    clock.stop("build")?;

    let simplified = simplify::simplify(scene, grid, options, &*tracer)?;
    let own = options.patches != PatchSource::Surfels;
    let face_tracer = own.then(|| trace::build(options.backend, &simplified.geometry)).transpose()?;
    simplify::check_rows(simplified.patches.len(), options.rays, forecast::RAY_BYTES)?;
    clock.stop("simplify")?;

    let inside = |hit: &Hit| hit.is_back() && !scene.triangles[hit.triangle()].two_sided;
    let lamps = LampPower::new(&lights, &*tracer, inside, options.seed);
    let mut lights = if options.primary == Primary::Radiosity { lights.without_surfaces() } else { lights };
    let exchange = Exchange {
        scene,
        simplified: &simplified,
        lights: &lights,
        tracer: &*tracer,
        foresight: &foresight,
        options,
        progress,
    };
    let census = Census::new(&lights).filter(|_| options.skip);
    let (direct, mut visibility) = exchange.direct(census.as_ref());
    let mut shadows = foresight.take();
    clock.stop("direct")?;

    let rows_tracer = face_tracer.as_deref().unwrap_or(&*tracer);
    let mut lit = exchange.lit(&direct);
    if !lit.contains(&true) {
        return Err(Error::Scene(format!(
            "scene \"{}\": no light reaches any surface; do the lights lie inside objects, or do lamps and walls turn \
             their backs to each other? (try --sides two, or `luxel check`)",
            scene.name
        )));
    }
    let index = PatchIndex::new(&simplified.patches, grid);
    let needs = Needs::new(scene, &simplified, &index, options, only.as_ref(), &foresight);
    let (mut row_rays, mut rows_seconds) = (0, 0.0);
    let (estimate, primary, bright) = loop {
        let estimate = needs.estimate(&simplified, rows_tracer, &lit, options, progress);
        row_rays += estimate.rays;
        rows_seconds += clock.stop("form factors")?;
        let primary = exchange.primary(&direct, &estimate.form_factors);
        let bright = exchange.bright(&primary, &estimate);
        if let Some(bright) = &bright {
            visibility += bright.rays;
            clock.stop("bright patches")?;
            // What only bright patches light needs rows too.
            if exchange.light_more(bright, &primary, &estimate, &mut lit) {
                continue;
            }
        }
        let f = &estimate.form_factors;
        let bright = bright.filter(|bright| exchange.is_balanced(bright, &primary, f));
        break (estimate, primary, bright);
    };
    let (secondary, solution, bands) = exchange.secondary(&primary, bright.as_ref(), &estimate.form_factors);
    shadows.1 += foresight.take().1;
    let mut light = PatchLight {
        direct: primary.direct,
        indirect: secondary.indirect,
        radiosity: secondary.radiosity,
        reached: estimate.reached,
        known: estimate.visible,
    };
    clock.stop("solve")?;

    needs.see(&mut light);
    needs.learn(&mut foresight, &simplified, &estimate.form_factors, &lights);
    let found = Found {
        plain,
        outer: needs.outer,
        clear: estimate.clear,
        outside: estimate.outside,
        few: estimate.few,
        own: needs.near.map(|[own, _]| own),
        shadows,
        dark: needs::forget_dark(&mut lights, census),
        bands,
    };
    let mesh = vertices::mesh(scene, &simplified, &light, &index, options, only.as_ref(), &*tracer);
    clock.stop("split mesh")?;

    let mut bake = Bake {
        mesh,
        vertices: Irradiance::default(),
        simplified,
        form_factors: estimate.form_factors,
        light,
        report: Report::default(),
        error: None,
        options: options.clone(),
        lights,
        bright: bright.map(|b| b.patches.lights),
        glow: primary.glow,
        smooth: secondary.smooth,
        carried: secondary.carried,
        foresight,
        index,
        normals: scene.normals(),
        two_sided: scene.triangles.iter().map(|t| t.two_sided).collect(),
        tracer,
        face_tracer,
    };
    bake.vertices = bake.light(&bake.mesh.samples, options.point_samples, progress);
    clock.stop("vertices")?;

    let error = options.estimate.then(|| estimate::estimate(scene, &bake));
    if error.is_some() {
        clock.stop("estimate")?;
    }

    let work = Work { solution, row_rays, visibility, rows_seconds, lamps, found };
    bake.report = measure::report(scene, &bake, work, clock);
    (bake.report.error, bake.error) = error.unzip();
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
