//! Known answers, computed again on the user's machine: form factors, CIE 171:2006, enclosures, invariants.
//!
//! Bounds come from statistics (standard errors of independent samples), from the digits of the tables, from rounding, or
//! are what another renderer has published. Nothing is tuned to pass.

use std::time::Instant;

use serde::Serialize;

use crate::{
    BakeOptions, Result,
    options::Backend,
    options::Resolution,
    progress::{self, Progress},
    trace,
};

pub mod cie;
pub mod closed_forms;
mod direct;
pub mod enclosures;
pub mod form_factors;
pub mod invariants;
mod row;
pub mod rows;
mod table;
pub mod world;

pub use row::{Figure, Row, SIGMAS, Verdict};
pub use world::World;

/// Cases that are computed together.
pub struct Group {
    /// What they are about.
    pub name: &'static str,
    /// Computes them.
    pub run: fn(Backend) -> Result<Vec<Row>>,
}

/// All cases, in the order of the table.
pub const GROUPS: [Group; 10] = [
    Group { name: "form factors", run: form_factors::catalogue },
    Group { name: "polygons", run: direct::polygons },
    Group { name: "CIE 5.3", run: cie::test_5_3 },
    Group { name: "CIE 5.4", run: cie::test_5_4 },
    Group { name: "CIE 5.6", run: cie::test_5_6 },
    Group { name: "CIE 5.8", run: cie::test_5_8 },
    Group { name: "furnaces", run: enclosures::furnaces },
    Group { name: "spheres", run: enclosures::spheres },
    Group { name: "voxel trap", run: enclosures::voxel_trap },
    Group { name: "invariants", run: invariants::invariants },
];

/// The table of a self-test.
#[derive(Clone, Debug, Serialize)]
pub struct Selftest {
    /// Version of luxel.
    pub version: &'static str,
    /// Threads used.
    pub threads: usize,
    /// Ray tracers, by name and version.
    pub tracers: Vec<String>,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// One row a case and ray tracer.
    pub rows: Vec<Row>,
}

impl Selftest {
    /// Whether no row failed.
    pub fn passed(&self) -> bool {
        self.failures().next().is_none()
    }

    /// The rows that failed.
    pub fn failures(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| row.verdict == Verdict::Fail)
    }
}

/// Every ray tracer that is compiled in.
pub fn backends() -> Vec<Backend> {
    let embree = cfg!(feature = "embree").then_some(Backend::Embree);
    embree.into_iter().chain([Backend::Bvh, Backend::Brute]).collect()
}

/// Computes all cases on each of `backends`.
///
/// # Errors
/// A bake that failed; an answer that is wrong is none, but a row that failed. [`Error::Interrupted`](crate::Error) if
/// `progress` asks to stop.
pub fn run(backends: &[Backend], progress: &dyn Progress) -> Result<Selftest> {
    let begun = Instant::now();
    let mut test = Selftest {
        version: env!("CARGO_PKG_VERSION"),
        threads: rayon::current_num_threads(),
        tracers: Vec::new(),
        seconds: 0.0,
        rows: Vec::new(),
    };
    for &backend in backends {
        let tracer = trace::build(backend, &trace::Geometry::default())?;
        test.tracers.push(tracer.name());
        progress.begin(&tracer.name(), GROUPS.len() as u64);
        for group in GROUPS {
            progress::go_on(progress, group.name)?;
            test.rows.extend((group.run)(backend)?.into_iter().map(|row| Row { backend: name(backend), ..row }));
            progress.advance(1);
        }
        progress.end();
    }
    test.seconds = begun.elapsed().as_secs_f64();
    Ok(test)
}

/// As the command line calls it.
fn name(backend: Backend) -> &'static str {
    match backend {
        Backend::Auto => "auto",
        Backend::Embree => "embree",
        Backend::Bvh => "bvh",
        Backend::Brute => "brute",
    }
}

/// Settings of a case.
fn options(grid: u32, rays: u32, backend: Backend) -> BakeOptions {
    BakeOptions { resolution: Resolution::Grid(grid), rays, backend, ..BakeOptions::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_row_that_fails_fails_the_test_and_is_named() {
        let rows = vec![Row::error("good", 1.0, 1.0, 0.1), Row::info("told", 2.0, 1.0)];
        let tracers = vec!["a tracer".into()];
        let good = Selftest { version: "1", threads: 2, tracers, seconds: 1.0, rows };
        assert!(good.passed());
        assert!(good.to_string().contains("1 of 1 pass"), "{good}");
        let mut bad = good.clone();
        bad.rows.push(Row { backend: "bvh", ..Row::error("broken", 1.2, 1.0, 0.1) });
        assert!(!bad.passed());
        assert!(bad.to_string().contains("1 of 2 pass") && bad.to_string().contains("FAILED: broken (bvh)"), "{bad}");
    }

    /// A lamp that is a tenth too bright, through the whole way from the scene to the verdict.
    #[test]
    fn a_scene_with_another_answer_fails() {
        let rows = |flux: f64| {
            let mut world = World::new();
            let grey = world.grey(0.5, 0.0);
            world.room(glam::DVec3::splat(-2.0), glam::DVec3::splat(2.0), grey);
            world.point_light(glam::DVec3::ZERO, flux);
            let bake = crate::bake(&world.build()?.0, &options(6, 256, Backend::Auto), &crate::progress::Silent)?;
            let mean = rows::patch_mean(&bake, &bake.light.indirect).x;
            Ok(Row::error("mean", mean, closed_forms::closed_mean(cie::FLUX, 96.0, 0.5), closed_forms::cycles::CIE_5_8))
        };
        let verdict = |flux| rows(flux).map(|row: Row| row.verdict).map_err(|e: crate::Error| e.to_string());
        assert_eq!(verdict(cie::FLUX), Ok(Verdict::Pass));
        assert_eq!(verdict(1.1 * cie::FLUX), Ok(Verdict::Fail));
    }
}
