//! What a bake tells about itself.

use std::time::Instant;

use crate::{
    Error, Result, Scene,
    light::LampPower,
    progress::{self, Progress},
    report::{Counts, Energy, Rays, Report, RowCounts, RowSums, Solver, Stage},
    skip,
    solve::Solution,
    transfer::{FormFactors, RowPoints},
};

use super::{
    Bake,
    skipped::{self, Found},
};

/// Times the stages.
pub(super) struct Clock<'a> {
    last: Instant,
    stages: Vec<Stage>,
    deadline: Option<Instant>,
    progress: &'a dyn Progress,
}

impl<'a> Clock<'a> {
    pub fn new(deadline: Option<Instant>, progress: &'a dyn Progress) -> Clock<'a> {
        Clock { last: Instant::now(), stages: Vec::new(), deadline, progress }
    }

    /// Seconds of a stage that has ended; zero if there was none.
    pub fn seconds(&self, name: &str) -> f64 {
        self.stages.iter().filter(|s| s.name == name).map(|s| s.seconds).sum()
    }

    /// Ends a stage, or a part of it; its seconds.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the deadline is over, [`Error::Interrupted`] if no more is wanted.
    pub fn stop(&mut self, name: &'static str) -> Result<f64> {
        let seconds = self.last.elapsed().as_secs_f64();
        match self.stages.iter_mut().find(|stage| stage.name == name) {
            Some(stage) => stage.seconds += seconds,
            None => self.stages.push(Stage { name, seconds }),
        }
        self.last = Instant::now();
        progress::go_on(self.progress, name)?;
        match self.deadline {
            Some(deadline) if self.last > deadline => Err(Error::Stopped(name.into())),
            _ => Ok(seconds),
        }
    }
}

/// What the stages took.
pub(super) struct Work<'a> {
    pub solution: Solution,
    pub row_rays: u64,
    /// Shadow rays to patches.
    pub visibility: u64,
    pub rows_seconds: f64,
    /// Rows that were cast.
    pub rows_cast: usize,
    /// Power of the lamps, W / scale^2.
    pub lamps: LampPower,
    pub found: Found,
    pub points: &'a RowPoints,
}

/// Measures a finished bake.
pub(super) fn report(scene: &Scene, bake: &Bake, work: Work, clock: Clock) -> Report {
    let (patches, f) = (bake.patches(), &bake.form_factors);
    let reached = bake.light.reached.iter().filter(|&&r| r).count();
    let skipped = skip::list(&skipped::audit(scene, bake, work.found, work.row_rays, work.points, &clock));
    Report {
        version: env!("CARGO_PKG_VERSION").into(),
        backend: bake.tracer().name(),
        instruction_set: bake.tracer().instruction_set(),
        threads: rayon::current_num_threads(),
        settings: Some(bake.options.clone()),
        counts: Counts {
            triangles: scene.triangles.len(),
            voxel_size: bake.simplified.grid.voxel_size * scene.frame.scale,
            voxels: patches.voxel.chunk_by(|a, b| a == b).count(),
            fragments: bake.simplified.fragments.len(),
            patches: patches.len(),
            patches_reached: reached,
            vertices: bake.mesh.positions.len(),
            form_factors: f.nonzeros(),
            form_factor_bytes: f.size_in_bytes(),
        },
        stages: clock.stages,
        rays: Rays {
            form_factors: work.row_rays,
            form_factor_mrays_per_second: work.row_rays as f64 / work.rows_seconds * 1e-6,
            visibility: work.visibility,
        },
        rows: RowCounts {
            used: (0..f.len()).filter(|&i| f.has_row(i)).count(),
            rays: f.all_rays(),
            cast: work.rows_cast,
            from: None,
            kept_in: None,
        },
        energy: energy(bake, &work.lamps, scene.frame.scale),
        row_sums: row_sums(f),
        solver: Solver { method: "bicgstab", iterations: work.solution.iterations, residual: work.solution.residual },
        skipped,
        warnings: scene.warnings.clone(),
        ..Report::default()
    }
}

/// Balance of power over the visible surfaces, in world units.
fn energy(bake: &Bake, lamps: &LampPower, scale: f64) -> Energy {
    let (patches, f, light) = (bake.patches(), &bake.form_factors, &bake.light);
    let world = |power: [f64; 3]| power.map(|p| p * scale * scale);
    let mut energy = Energy { emitted: world(lamps.emitted), missed: world(lamps.missed), ..Energy::default() };
    for i in 0..patches.len() {
        let area = patches.area[i] as f64 * (1.0 - f.hidden(i)) * scale * scale;
        for c in 0..3 {
            let (direct, indirect) = (light.direct[i][c] as f64, light.indirect[i][c] as f64);
            energy.direct[c] += area * direct;
            energy.absorbed[c] += area * (direct + indirect) * (1.0 - patches.albedo[i][c] as f64);
            energy.escaped[c] += area * light.radiosity[i][c] as f64 * f.escape(i);
        }
    }
    for c in 0..3 {
        let balance = energy.direct[c] - energy.absorbed[c] - energy.escaped[c];
        energy.imbalance[c] = if energy.direct[c] > 0.0 { balance / energy.direct[c] } else { 0.0 };
    }
    let lost = |c: usize| {
        let balance = energy.emitted[c] - energy.missed[c] - energy.absorbed[c] - energy.escaped[c];
        if energy.emitted[c] > 0.0 { balance / energy.emitted[c] } else { 0.0 }
    };
    energy.unaccounted = (!bake.lights.has_unbounded()).then(|| std::array::from_fn(lost));
    energy
}

fn row_sums(f: &FormFactors) -> RowSums {
    let rows: Vec<usize> = (0..f.len()).filter(|&i| f.has_row(i)).collect();
    let sums = || rows.iter().map(|&i| f.raw_row_sum(i));
    let count = rows.len().max(1) as f64;
    RowSums {
        min: sums().fold(1.0, f64::min),
        mean: sums().sum::<f64>() / count,
        max: sums().fold(0.0, f64::max),
        closed: f.is_closed(),
        hidden: rows.iter().map(|&i| f.hidden(i)).sum::<f64>() / count,
    }
}
