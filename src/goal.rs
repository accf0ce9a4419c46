//! Bakes to an error or a time: settings are found by baking.
//!
//! A coarse bake tells what its error is made of, and how long it took. Each part of the error falls with its own setting
//! (shadow noise with samples, row noise with rays, discretisation with the grid) by a known law, and so does the work
//! grow: the cheapest settings that should do are baked next. Steps are bounded, since laws hold better near by; the
//! work of all steps but the last is a small share of the whole.

use std::time::{Duration, Instant};

use crate::{
    BakeOptions, Error, Result, Scene,
    bake::{self, Bake, Kept, Run},
    options::{Primary, Resolution},
    progress::Progress,
    report::{ErrorParts, GoalReport, GoalStep},
    simplify::{self, Grid, grid::MAX_DIM},
    transfer::RowKeeper,
};

/// What a bake shall reach. Without target and budget it is one bake.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Goal {
    /// Estimated error of total light to reach: a share of its mean, above 0.
    pub target_error: Option<f64>,
    /// Time for all bakes together. One that would not end in it is not begun, and one that does not end in it is
    /// given up at the end of a stage; the first is always finished.
    pub budget: Option<Duration>,
    /// Leave the resolution as it is.
    pub fixed_resolution: bool,
    /// Leave the rays as they are.
    pub fixed_rays: bool,
    /// Leave the shadow samples of points as they are.
    pub fixed_samples: bool,
}

/// Where the search begins.
const FIRST: Setting = Setting { resolution: Resolution::Grid(16), fineness: 16.0, rays: 64, samples: 16 };
/// Steps between grids: half an octave.
const GRID_STEP: f64 = std::f64::consts::SQRT_2;
const MOST_RAYS: u32 = 65536;
const MOST_SAMPLES: u32 = 4096;
/// Work of a bake as a multiple of the last one's.
const GROWTH: f64 = 16.0;
/// Share of the target that is aimed at, and of the remaining time that is planned for.
const AIM: f64 = 0.85;
const PLAN: f64 = 0.8;
/// A bake that is expected to have more than this share of the best error is not worth it.
const WORTH: f64 = 0.9;
/// Bakes at most, and those in a row that may be no better than others.
const MOST_STEPS: usize = 12;
const MOST_FAILURES: usize = 2;

/// Variance falls as these powers of shadow samples and of rays (Sobol points: faster than 1), the square of the
/// discretisation error as this power of the voxels along a side: measured, see ARCHITECTURE.md.
const SAMPLES_POWER: f64 = 1.5;
const RAYS_POWER: f64 = 1.25;
const GRID_POWER: f64 = 2.5;

/// Work in nanoseconds of one thread: of a ray of a row with its part in the solution, of a shadow ray, of a vertex, of a
/// fragment. Only their ratios matter.
const ROW_RAY: f64 = 200.0;
const SHADOW_RAY: f64 = 120.0;
const VERTEX: f64 = 3000.0;
const FRAGMENT: f64 = 4000.0;

/// What is varied.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setting {
    resolution: Resolution,
    /// Voxels along the longest side.
    fineness: f64,
    rays: u32,
    samples: u32,
}

/// Bakes `scene` until `goal` is reached, and returns the bake with the least estimated error; its report holds the
/// search. `options` say what is not searched for: all but grid, rays and samples of points.
///
/// Without a budget the result depends on nothing but the input: the same bits every time.
///
/// # Errors
/// Those of [`bake()`](crate::bake()) for the first bake; [`Error::Option`] for a target without sense, or without an
/// estimate.
pub fn bake_to(scene: &Scene, options: &BakeOptions, goal: &Goal, progress: &dyn Progress) -> Result<Bake> {
    bake_to_kept(scene, options, goal, &mut (), progress)
}

/// As [`bake_to`]; `keeper` is shown the rows of every bake.
///
/// # Errors
/// Those of [`bake_to`], and of the keeper for the first bake.
pub fn bake_to_kept(
    scene: &Scene,
    options: &BakeOptions,
    goal: &Goal,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<Bake> {
    if goal.target_error.is_none() && goal.budget.is_none() {
        return bake::bake_with(scene, options, &mut Kept::default(), &mut Run { progress, keeper, deadline: None });
    }
    if goal.target_error.is_some_and(|t| !(t > 0.0 && t.is_finite())) {
        return Err(Error::Option("the target error must be above 0".into()));
    }
    if !options.estimate {
        return Err(Error::Option("a target error or budget needs the estimate of the error".into()));
    }
    Search { scene, options, goal, keeper, progress, begun: Instant::now(), steps: Vec::new() }.run()
}

struct Search<'a> {
    scene: &'a Scene,
    options: &'a BakeOptions,
    goal: &'a Goal,
    keeper: &'a mut dyn RowKeeper,
    progress: &'a dyn Progress,
    begun: Instant,
    steps: Vec<GoalStep>,
}

/// A bake and what follows from it.
struct Found {
    bake: Bake,
    setting: Setting,
    error: ErrorParts,
    seconds: f64,
}

impl Search<'_> {
    fn run(mut self) -> Result<Bake> {
        let mut best = self.step(self.first()?, None, None)?;
        let deadline = self.goal.budget.map(|budget| self.begun + budget);
        let mut last: Option<Found> = None;
        let mut failures = 0;
        let ended = loop {
            if self.goal.target_error.is_some_and(|target| best.error.total <= target) {
                break "the target is reached".to_string();
            }
            if self.steps.len() == MOST_STEPS {
                break format!("{MOST_STEPS} bakes did not do");
            }
            if failures == MOST_FAILURES {
                break "the error does not fall any more".into();
            }
            let from = last.as_ref().unwrap_or(&best);
            let Some((setting, expected)) = self.next(from, best.error.total) else {
                break match self.goal.budget {
                    Some(_) => "no better bake fits into the time".into(),
                    None => "no settings promise less".into(),
                };
            };
            let found = match self.step(setting, Some(expected), deadline) {
                Ok(found) => found,
                Err(error @ Error::Interrupted(_)) => return Err(error),
                // What was baked before is there still.
                Err(error) => break error.to_string(),
            };
            failures = if found.error.total < WORTH * best.error.total { 0 } else { failures + 1 };
            if found.error.total < best.error.total {
                (best, last) = (found, None);
            } else {
                last = Some(found);
            }
        };
        let mut bake = best.bake;
        bake.report.goal = Some(GoalReport {
            target_error: self.goal.target_error,
            budget_seconds: self.goal.budget.map(|b| b.as_secs_f64()),
            reached: self.goal.target_error.map(|target| best.error.total <= target),
            ended,
            seconds: self.begun.elapsed().as_secs_f64(),
            steps: self.steps,
        });
        Ok(bake)
    }

    fn first(&self) -> Result<Setting> {
        let resolution = if self.goal.fixed_resolution { self.options.resolution } else { FIRST.resolution };
        Ok(Setting {
            resolution,
            fineness: self.fineness(resolution)?,
            rays: if self.goal.fixed_rays { self.options.rays } else { FIRST.rays },
            samples: if self.goal.fixed_samples { self.options.point_samples } else { FIRST.samples },
        })
    }

    fn bake(&mut self, options: &BakeOptions, deadline: Option<Instant>) -> Result<Bake> {
        let mut run = Run { progress: self.progress, keeper: &mut *self.keeper, deadline };
        bake::bake_with(self.scene, options, &mut Kept::default(), &mut run)
    }

    /// Voxels along the longest side of the scene.
    fn fineness(&self, resolution: Resolution) -> Result<f64> {
        let one = Grid::new(self.scene, Resolution::Grid(1))?.voxel_size;
        Ok(one / Grid::new(self.scene, resolution)?.voxel_size)
    }

    fn step(&mut self, setting: Setting, expected: Option<f64>, deadline: Option<Instant>) -> Result<Found> {
        let Setting { resolution, fineness, rays, samples } = setting;
        let options = BakeOptions { resolution, rays, point_samples: samples, ..self.options.clone() };
        let begun = Instant::now();
        let bake = self.bake(&options, deadline);
        let seconds = begun.elapsed().as_secs_f64();
        let error = bake.as_ref().ok().and_then(|b| b.report.error.as_ref()).map(|e| e.total);
        let told = error.map(|e| e.total);
        self.steps.push(GoalStep { grid: fineness, rays, point_samples: samples, error: told, expected, seconds });
        Ok(Found { bake: bake?, setting, error: error.unwrap_or_default(), seconds })
    }

    /// The settings to bake next, and the error to expect of them.
    fn next(&self, from: &Found, best: f64) -> Option<(Setting, f64)> {
        let law = Law::new(self.scene, self.options, from)?;
        let now = law.work(from.setting, 1.0);
        let mut most = GROWTH * now;
        if let Some(budget) = self.goal.budget {
            let remaining = budget.saturating_sub(self.begun.elapsed()).as_secs_f64();
            most = most.min(now * PLAN * remaining / from.seconds.max(1e-3));
        }
        let mut cheapest: Option<(f64, Setting, f64)> = None;
        let mut least: Option<(f64, Setting, f64)> = None;
        for (setting, pieces) in self.candidates(from.setting, &law) {
            let (work, error) = (law.work(setting, pieces), law.error(setting));
            if work > most || error > WORTH * best {
                continue;
            }
            let does = self.goal.target_error.is_some_and(|target| error <= AIM * target);
            if does && cheapest.is_none_or(|c| work < c.0) {
                cheapest = Some((work, setting, error));
            }
            if least.is_none_or(|l| error < l.2) {
                least = Some((work, setting, error));
            }
        }
        cheapest.or(least).map(|(_, setting, error)| (setting, error))
    }

    /// All settings, with the pieces of surface as a multiple of what they are now.
    fn candidates(&self, from: Setting, law: &Law) -> Vec<(Setting, f64)> {
        let mut all = Vec::new();
        let grids: Vec<(Resolution, f64)> = if self.goal.fixed_resolution {
            vec![(from.resolution, from.fineness)]
        } else {
            let grid = |k: i32| (FIRST.fineness * GRID_STEP.powi(k)).round() as u32;
            (0..).map(grid).take_while(|&n| n <= MAX_DIM).map(|n| (Resolution::Grid(n), n as f64)).collect()
        };
        let doubled = |first: u32, most: u32, fixed: bool, now: u32| -> Vec<u32> {
            if fixed { vec![now] } else { (0..32).map(|k| first << k).take_while(|&n| n <= most).collect() }
        };
        for &(resolution, fineness) in &grids {
            let Some(pieces) = law.pieces(self.scene, resolution) else { continue };
            for &rays in &doubled(FIRST.rays, MOST_RAYS, self.goal.fixed_rays, from.rays) {
                for &samples in &doubled(FIRST.samples, MOST_SAMPLES, self.goal.fixed_samples, from.samples) {
                    all.push((Setting { resolution, fineness, rays, samples }, pieces));
                }
            }
        }
        all
    }
}

/// How error and work go on from a bake.
struct Law {
    from: Setting,
    /// Squares of errors that fall with samples, rays and grid.
    squares: [f64; 3],
    /// Expected pieces of surface.
    pieces: f64,
    /// Work that goes with pieces alone, with rays and with samples.
    works: [f64; 3],
}

impl Law {
    fn new(scene: &Scene, options: &BakeOptions, from: &Found) -> Option<Law> {
        let (e, counts) = (&from.error, &from.bake.report.counts);
        let grid = Grid::new(scene, from.setting.resolution).ok()?;
        let (fragments, vertices) = (counts.fragments as f64, counts.vertices as f64);
        let (patches, reached) = (counts.patches as f64, counts.patches_reached as f64);
        let shadow_rays = if options.primary == Primary::Direct { 1.0 } else { 0.0 };
        let alone = fragments * FRAGMENT
            + vertices * VERTEX
            + patches * options.patch_samples as f64 * SHADOW_RAY * shadow_rays;
        Some(Law {
            from: from.setting,
            squares: [e.shadow_noise.powi(2), e.row_noise.powi(2), e.discretisation.powi(2)],
            pieces: simplify::expected_fragments(scene, &grid),
            works: [alone, reached * ROW_RAY, vertices * SHADOW_RAY],
        })
    }

    /// Pieces of surface as a multiple of those of the bake; `None` if the voxels do not fit the scene.
    fn pieces(&self, scene: &Scene, to: Resolution) -> Option<f64> {
        let grid = Grid::new(scene, to).ok()?;
        Some(simplify::expected_fragments(scene, &grid) / self.pieces)
    }

    fn work(&self, to: Setting, pieces: f64) -> f64 {
        let [alone, rays, samples] = self.works;
        pieces * (alone + rays * to.rays as f64 + samples * to.samples as f64)
    }

    fn error(&self, to: Setting) -> f64 {
        let [shadow, rows, detail] = self.squares;
        let ratio = |from: f64, to: f64, power: f64| (from / to).powf(power);
        let square = shadow * ratio(self.from.samples as f64, to.samples as f64, SAMPLES_POWER)
            + rows * ratio(self.from.rays as f64, to.rays as f64, RAYS_POWER)
            + detail * ratio(self.from.fineness, to.fineness, GRID_POWER);
        square.sqrt()
    }
}
