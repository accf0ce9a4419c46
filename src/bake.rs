//! The program: one line a stage, in the order of the paper's algorithm.

use std::time::Instant;

use crate::{
    BakeOptions, Error, Result, Scene, estimate,
    light::{Census, LampPower, LightSet},
    options::Primary,
    progress::Progress,
    report::Report,
    trace::Hit,
    transfer::RowKeeper,
};

mod exchange;
mod finished;
mod measure;
mod needs;
mod outline;
mod outlook;
mod prepared;
mod relit;
mod scout;
mod sight;
mod skipped;
mod tracers;
mod vertices;

pub(crate) use exchange::is_balanced;
pub use finished::{Bake, Irradiance, PatchLight};
pub use outline::{Outline, Outlined, Shared, outline};
pub(crate) use outlook::of_rows;
pub use prepared::Kept;
pub(crate) use prepared::{AGAIN_A_BLOCK, ROWS_A_BLOCK};
pub(crate) use relit::RelitLight;
pub use sight::Sight;

use exchange::Exchange;
use measure::{Clock, Work};
use outlook::{Coming, Purpose};
use prepared::Prepared;
use skipped::Found;

/// Bakes a scene.
///
/// # Errors
/// [`Error::Scene`] without geometry or light, [`Error::Backend`] for a tracer that is not there, [`Error::Option`]
/// for options without sense or voxels too small for the memory, [`Error::Interrupted`] if `progress` asks to stop.
pub fn bake(scene: &Scene, options: &BakeOptions, progress: &dyn Progress) -> Result<Bake> {
    bake_with(scene, options, &mut Kept::default(), &mut Run { progress, keeper: &mut (), deadline: None })
}

/// What runs beside a bake.
pub struct Run<'a> {
    /// Is told of the progress.
    pub progress: &'a dyn Progress,
    /// Is shown the rows that are cast.
    pub keeper: &'a mut dyn RowKeeper,
    /// When to give up: at the end of the first stage that ends later, if it is not the last.
    pub deadline: Option<Instant>,
}

/// As [`bake`], with what is kept of earlier work.
///
/// # Errors
/// Those of [`bake`] and of the keeper of `run`; [`Error::Stopped`] after its deadline.
pub fn bake_with(scene: &Scene, options: &BakeOptions, kept: &mut Kept, run: &mut Run) -> Result<Bake> {
    check(scene, options)?;
    if !scene.has_light() {
        return Err(Error::Scene(scene.no_light_message()));
    }
    let mut clock = Clock::new(run.deadline, run.progress);
    let prepared = Prepared::new(scene, options, kept, run.keeper.limit(), &mut clock)?;
    light(prepared, options, kept, run, clock)
}

/// Makes what a bake of `scene` needs for any lights and albedos, and puts it into `kept`: all of it is there after; how
/// many form-factor rays that took.
///
/// # Errors
/// Those of [`bake_with`], but for the lack of light.
pub fn prepare(scene: &Scene, options: &BakeOptions, kept: &mut Kept, run: &mut Run) -> Result<u64> {
    check(scene, options)?;
    kept.marked = true;
    let mut clock = Clock::new(run.deadline, run.progress);
    let prepared = Prepared::new(scene, options, kept, run.keeper.limit(), &mut clock)?;
    let rays = prepared.cast(options, kept, run.keeper, run.progress)?;
    kept.stencils = Some(prepared.stencils(options, &kept.rows));
    kept.simplified = Some(prepared.simplified);
    Ok(rays)
}

/// Lights a prepared scene.
fn light(prepared: Prepared, options: &BakeOptions, kept: &mut Kept, run: &mut Run, mut clock: Clock) -> Result<Bake> {
    let progress = run.progress;
    let Prepared { scene, plain, only, tracers, points, mut foresight, simplified, index, needs, before } = prepared;
    let (scene, only) = (&*scene, only.as_ref());
    let lights = LightSet::new(scene);
    let inside = |hit: &Hit| hit.is_back() && !scene.triangles[hit.triangle()].two_sided;
    let lamps = LampPower::new(&lights, tracers.surfaces(), inside, options.seed);
    let mut lights = if options.primary == Primary::Radiosity { lights.without_surfaces() } else { lights };
    let exchange = Exchange {
        scene,
        simplified: &simplified,
        lights: &lights,
        tracer: tracers.surfaces(),
        foresight: &foresight,
        options,
        progress,
    };
    let census = Census::new(&lights).filter(|_| options.skip);
    let (direct, mut visibility) = exchange.direct(census.as_ref());
    let mut shadows = foresight.take();
    clock.stop("direct")?;

    let casting = needs.casting(&simplified, tracers.patches(), &points, kept.marked);
    let mut lit = exchange.lit(&direct);
    if !lit.contains(&true) {
        return Err(Error::Scene(format!(
            "scene \"{}\": no light reaches any surface; do the lights lie inside objects, or do lamps and walls turn \
             their backs to each other? (try --sides two, or `luxel check`)",
            scene.name
        )));
    }
    let coming = Coming { scene, casting: &casting, plan: needs.plan(&lit), purpose: Purpose::Light, before };
    coming.begin(&mut kept.rows, options, run.keeper, progress)?;
    let (mut row_rays, mut rows_seconds) = (0, 0.0);
    let blocks_before = kept.rows.blocks().len();
    let (estimate, primary, bright) = loop {
        let estimate = needs.estimate(&casting, &lit, &mut kept.rows, run.keeper, progress)?;
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
    let spilled = run.keeper.spills();
    let (secondary, solution, bands) = exchange.secondary(&primary, bright.as_ref(), &estimate.form_factors, spilled);
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
    let mesh = vertices::mesh(scene, &simplified, &light.reached, &index, options, only, tracers.surfaces());
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
        stencils: kept.stencils.take(),
        foresight,
        index,
        normals: scene.normals(),
        two_sided: scene.triangles.iter().map(|t| t.two_sided).collect(),
        tracers,
    };
    bake.vertices = bake.light(&bake.mesh.samples, options.point_samples, progress);
    clock.stop("vertices")?;

    let error = options.estimate.then(|| estimate::estimate(scene, &bake, &points, kept, progress)).transpose()?;
    if error.is_some() {
        clock.stop("estimate")?;
    }

    let rows_cast = kept.rows.blocks()[blocks_before..].iter().map(|block| block.rows.len()).sum();
    let work = Work { solution, row_rays, visibility, rows_seconds, rows_cast, lamps, found, points: &points };
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
    Ok(())
}
