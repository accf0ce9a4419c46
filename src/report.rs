//! What a bake tells about itself: the content of `bake.json`.

use serde::Serialize;

use crate::options::BakeOptions;

/// Everything measured in one bake. Lengths, areas and powers are in world units.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Version of luxel.
    pub version: String,
    /// Tracer that ran, with its version.
    pub backend: String,
    /// Instruction set that the tracer chose, where it says.
    pub instruction_set: String,
    /// Threads used.
    pub threads: usize,
    /// The settings; `None` until the bake begins.
    pub settings: Option<BakeOptions>,
    /// Sizes.
    pub counts: Counts,
    /// Wall-clock seconds of every stage, in order.
    pub stages: Vec<Stage>,
    /// Ray statistics.
    pub rays: Rays,
    /// Rows of form factors: which were there, which were cast.
    pub rows: RowCounts,
    /// Largest resident memory of the process, bytes.
    pub peak_memory_bytes: u64,
    /// What was foretold of it before the form factors were cast, bytes, where a limit asked for it; without form factors
    /// that went to a file.
    pub foretold_memory_bytes: Option<u64>,
    /// Balance of power.
    pub energy: Energy,
    /// Sums of the form-factor rows as estimated, before a closed scene's are normalised.
    pub row_sums: RowSums,
    /// The radiosity solution.
    pub solver: Solver,
    /// Estimate of the error at the vertices; `None` if none was asked for.
    pub error: Option<ErrorReport>,
    /// How the settings were found, if a goal was set instead.
    pub goal: Option<GoalReport>,
    /// What was not computed, and why that is right.
    pub skipped: Vec<Skipped>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// Sizes of the scene and of its simplification.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Counts {
    /// Triangles of the scene.
    pub triangles: usize,
    /// Voxel size, world units.
    pub voxel_size: f64,
    /// Voxels that hold a surface.
    pub voxels: usize,
    /// Pieces of triangles, cut by the voxels.
    pub fragments: usize,
    /// Patches.
    pub patches: usize,
    /// Patches that light reaches.
    pub patches_reached: usize,
    /// Vertices of the split mesh.
    pub vertices: usize,
    /// Nonzero form factors.
    pub form_factors: usize,
    /// Bytes that hold them.
    pub form_factor_bytes: usize,
}

/// The time of one stage.
#[derive(Clone, Debug, Serialize)]
pub struct Stage {
    /// Name, as in the README's pipeline.
    pub name: &'static str,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// Ray counts.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Rays {
    /// Rays for form factors, probes of reach among them.
    pub form_factors: u64,
    /// Rays a second of the form-factor stage, millions.
    pub form_factor_mrays_per_second: f64,
    /// Shadow and visibility rays.
    pub visibility: u64,
}

/// Rows of form factors, by where they came from. Everything but these, the times and the rays is the same wherever that
/// was.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RowCounts {
    /// Rows that the solution uses.
    pub used: usize,
    /// Rays of these, whoever cast them.
    pub rays: u64,
    /// Rows that this bake cast.
    pub cast: usize,
    /// The file that other rows came from; `None` if there was none.
    pub from: Option<String>,
    /// The file that the rows are kept in; `None` if they are not, or were there before.
    pub kept_in: Option<String>,
}

/// Balance of power per RGB channel, W.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Energy {
    /// Power that the lamps emit, in closed form; suns and skies, whose power has no bound, are not in it.
    pub emitted: [f64; 3],
    /// Power of the lamps that no surface receives: it leaves the scene, goes into objects, or ends with the lamp's
    /// range. By 262,144 rays from the lamps.
    pub missed: [f64; 3],
    /// Power that the lights send onto surfaces, as received directly.
    pub direct: [f64; 3],
    /// Power that surfaces absorb.
    pub absorbed: [f64; 3],
    /// Reflected power that leaves the scene.
    pub escaped: [f64; 3],
    /// direct - absorbed - escaped, as a share of direct.
    pub imbalance: [f64; 3],
    /// emitted - missed - absorbed - escaped, as a share of emitted; `None` where suns or skies light the scene too.
    pub unaccounted: Option<[f64; 3]>,
}

/// Statistics of row sums.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RowSums {
    /// Smallest.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
    /// Whether the scene is closed, so that rows were normalised to 1.
    pub closed: bool,
    /// Share of rays that met the back of a one-sided surface: their origins are hidden, they were dropped.
    pub hidden: f64,
}

/// How the system was solved.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Solver {
    /// Method.
    pub method: &'static str,
    /// Iterations.
    pub iterations: usize,
    /// max |M + rho F B - B| / max |M|.
    pub residual: f64,
}

/// Estimated error of irradiance over the area of the split mesh.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ErrorReport {
    /// Of direct light.
    pub direct: ErrorParts,
    /// Of indirect light.
    pub indirect: ErrorParts,
    /// Of both together.
    pub total: ErrorParts,
    /// Vertices that the estimate looked at.
    pub vertices: usize,
    /// Where few places carry most of the error of the sum; `None` if it lies everywhere.
    pub peak: Option<ErrorPeak>,
}

/// The points with the largest squares, as many as have three quarters of the squares of the error, if these are on at most a
/// twentieth of the area.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorPeak {
    /// Their middle, weighted by the squares, world coordinates.
    pub position: [f64; 3],
    /// Root of their mean square distance from it, world units.
    pub radius: f64,
    /// Their share of the squares.
    pub squares: f64,
    /// Their share of the area.
    pub area: f64,
    /// How many of the vertices that the estimate looked at these are.
    pub vertices: usize,
    /// The largest part of the error there, by the name that it has in [`ErrorParts`].
    pub mostly: &'static str,
}

/// Errors of luminance, as shares of its mean: roots of mean squares.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ErrorParts {
    /// By the shadow rays of vertices: more `point_samples` make it smaller.
    pub shadow_noise: f64,
    /// By the rays of patches: more `rays` make it smaller.
    pub row_noise: f64,
    /// Of both.
    pub noise: f64,
    /// By the size of the patches: a finer grid makes it smaller.
    pub discretisation: f64,
    /// Of noise and discretisation.
    pub total: f64,
    /// The size that the error stays below on 95 % of the area.
    pub p95: f64,
}

/// A search for settings.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GoalReport {
    /// Error of total light that was asked for, as a share of its mean.
    pub target_error: Option<f64>,
    /// Seconds that were given.
    pub budget_seconds: Option<f64>,
    /// Whether the estimated error is at most the target; `None` without a target.
    pub reached: Option<bool>,
    /// Why the search ended.
    pub ended: String,
    /// Seconds of all bakes.
    pub seconds: f64,
    /// The bakes, in order.
    pub steps: Vec<GoalStep>,
}

/// One bake of a search.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GoalStep {
    /// Voxels along the longest side.
    pub grid: f64,
    /// Form-factor rays a patch.
    pub rays: u32,
    /// Shadow rays a vertex.
    pub point_samples: u32,
    /// Estimated error of total light, as a share of its mean; `None` if the bake was stopped.
    pub error: Option<f64>,
    /// What the step before made expect; `None` for the first.
    pub expected: Option<f64>,
    /// Seconds.
    pub seconds: f64,
}

/// One thing that was skipped.
#[derive(Clone, Debug, Serialize)]
pub struct Skipped {
    /// What and why.
    pub what: String,
    /// Patches that were saved.
    pub patches: usize,
    /// Rays that were saved.
    pub rays: u64,
    /// Seconds that were saved: the rays, at the rate of those that were cast; `None` where that is not known.
    pub seconds: Option<f64>,
    /// Relative bound or measurement of the error it costs, where it is a number.
    pub bound: Option<f64>,
    /// What the bound is, and why.
    pub error: String,
}
