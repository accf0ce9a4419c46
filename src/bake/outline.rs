//! What the parts of a bake have in common that are done by several processes.

use serde::{Deserialize, Serialize};

use super::{Kept, Run, Sight, check, measure::Clock, outlook, prepared::Prepared};
use crate::{
    BakeOptions, Result, Scene,
    options::PatchSource,
    outlook::Outlook,
    scene::SurfacePoint,
    trace::RayTracer,
    transfer::{self, RowPoints},
};

/// How the rows of [`prepare`](super::prepare) are cast, besides patches and options. Lists are by patch; empty ones hold
/// for no patch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outline {
    /// Patches that no surface lies before.
    pub outer: Vec<bool>,
    /// Patches whose rows have fewer rays.
    pub few: Vec<bool>,
    /// Patches whose rows are there already, or that need none.
    pub spared: Vec<bool>,
}

/// What [`outline`] makes.
pub struct Outlined {
    /// How rows are cast.
    pub outline: Outline,
    /// What is to be known for the vertices; `None` where these are not made before all rows are there.
    pub shared: Option<Shared>,
    /// Where the rays of rows start and go.
    pub points: RowPoints,
    /// Tracer of what the patches are pieces of.
    pub tracer: Box<dyn RayTracer>,
    /// How long it takes to build one, seconds.
    pub build_seconds: f64,
}

/// The vertices of [`prepare`](super::prepare), and what their stencils depend on.
pub struct Shared {
    /// Where their light is computed.
    pub points: Vec<SurfacePoint>,
    /// What they see, if the rows show those patches to be visible that were foreseen to be.
    pub sight: Sight,
}

/// Does the part of [`prepare`](super::prepare) that cannot be shared out: makes the patches, and with
/// [`BakeOptions::only`] casts the rows of those that tell what matters. Puts both into `kept`. Without it, and where patches
/// are pieces of the surfaces, it makes the vertices too.
///
/// The rows that are left are of a few more patches than `prepare` would cast with `only`, since only their rows would
/// tell which of them matter. Given all of them, `prepare` casts no ray, and keeps what it would without them.
///
/// # Errors
/// Those of [`prepare`](super::prepare).
pub fn outline(scene: &Scene, options: &BakeOptions, kept: &mut Kept, run: &mut Run) -> Result<Outlined> {
    check(scene, options)?;
    kept.marked = true;
    let mut clock = Clock::new(run.deadline, run.progress);
    let prepared = Prepared::new(scene, options, kept, run.keeper.limit(), &mut clock)?;
    let needs = &prepared.needs;
    let casting = prepared.casting(true);
    let (mut few, mut spared, mut shared) = (Vec::new(), Vec::new(), None);
    if let Some([_, near]) = &needs.near {
        let plan = needs.plan(near);
        let own: Vec<u32> = (0..).zip(near).filter(|(_, near)| **near).map(|(i, _)| i).collect();
        run.keeper.begin(&mut kept.rows, &|| outlook::of_rows(&casting, &own, run.progress))?;
        few = transfer::first_wave(&casting, &plan, &mut kept.rows, run.keeper, run.progress)?;
        spared = near.iter().zip(plan.black).map(|(near, black)| near | black).collect();
    } else if options.patches == PatchSource::Surfels && options.only.is_empty() {
        run.keeper
            .begin(&mut kept.rows, &|| Ok(outlook::of_mesh(&prepared.scene, &prepared.simplified, prepared.before)))?;
        let known = transfer::foresee_visible(&casting);
        clock.stop("visible patches")?;
        let points = prepared.points_of_vertices(options, &known);
        shared = Some(Shared { points, sight: Sight::new(&prepared, known, options) });
        clock.stop("split mesh")?;
    } else {
        run.keeper.begin(&mut kept.rows, &|| Ok(Outlook::of_rows(0.0)))?;
    }
    let outline = Outline { outer: needs.outer.clone(), few, spared };
    kept.simplified = Some(prepared.simplified);
    let build_seconds = clock.seconds("build");
    Ok(Outlined { outline, shared, points: prepared.points, tracer: prepared.tracers.into_patches(), build_seconds })
}
