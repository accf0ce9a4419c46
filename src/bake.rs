//! The program: one line a stage, in the order of the paper's algorithm.

use std::borrow::Cow;

use crate::{
    BakeOptions, Error, Result, Scene, forecast,
    light::{Census, LightSet},
    options::{PatchSource, Primary},
    progress::Progress,
    reconstruct::PatchIndex,
    report::Report,
    simplify::{self, Grid},
    skip::{self, Foresight, Wanted},
    trace, transfer,
};

mod exchange;
mod finished;
mod measure;
mod needs;
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
    check(scene, options)?;
    let only = Wanted::new(scene, &options.only)?;
    let mut clock = Clock::new();
    let (scene, plain) = if options.skip { skip::plain(scene) } else { (Cow::Borrowed(scene), Vec::new()) };
    let scene = &*scene;

    let grid = Grid::new(scene, options.resolution)?;
    simplify::check_size(scene, &grid, forecast::FRAGMENT_BYTES)?;
    let geometry = scene.geometry();
    let tracer = trace::build(options.backend, &geometry)?;
    let mut foresight = Foresight::new(options.skip, &geometry);
    let lights = LightSet::new(scene);
    clock.stop("build");

    let (simplified, face_tracer) = match options.patches {
        PatchSource::Surfels => (simplify::surfels(scene, grid, &*tracer), None),
        PatchSource::Faces => {
            let simplified = simplify::faces(scene, grid, options.face_colour);
            let face_tracer = trace::build(options.backend, &simplified.geometry)?;
            (simplified, Some(face_tracer))
        }
    };
    simplify::check_rows(simplified.patches.len(), options.rays, forecast::RAY_BYTES)?;
    clock.stop("simplify");

    let mut lights = if options.primary == Primary::Radiosity { lights.without_surfaces() } else { lights };
    let exchange = Exchange {
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
    let index = PatchIndex::new(&simplified.patches, grid);
    let needs = Needs::new(scene, &simplified, &index, options, only.as_ref(), &foresight);
    let plan = needs.plan(&lit);
    let mut estimate = transfer::estimate_plan(&simplified, rows_tracer, &plan, options.rays, options.seed, progress);
    if plan.backwards {
        // All that is lit may send light to the wanted meshes, by shadow rays too.
        estimate.reached.iter_mut().zip(&lit).for_each(|(reached, lit)| *reached |= lit);
    }
    let rows_seconds = clock.stop("form factors");

    let primary = exchange.primary(direct, &estimate.form_factors);
    let (bright, rays) = exchange.bright(&primary, &estimate);
    visibility += rays;
    if rays > 0 {
        clock.stop("bright patches");
    }
    let (secondary, solution, bands) = exchange.secondary(&primary, bright.as_ref(), &estimate.form_factors);
    shadows.1 += foresight.take().1;
    let mut light = PatchLight {
        direct: primary.direct,
        indirect: secondary.indirect,
        radiosity: secondary.radiosity,
        reached: estimate.reached,
        known: estimate.visible,
    };
    clock.stop("solve");

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
        foresight,
        index,
        normals: scene.normals(),
        tracer,
        face_tracer,
    };
    bake.vertices = bake.light(&bake.mesh.samples, options.point_samples, progress);
    clock.stop("vertices");

    let work = Work { solution, row_rays: estimate.rays, visibility, rows_seconds, found };
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
