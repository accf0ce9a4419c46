//! From some places to all: means over neighbourhoods.

use std::collections::HashMap;

use crate::{scene::SurfacePoint, simplify::Grid};

/// Edges of the neighbourhoods, in voxels, from small to large.
const EDGES: [u32; 2] = [4, 16];
/// A neighbourhood's own values count as many as these of the next larger one.
const PRIOR: f64 = 2.0;
/// Light at which variance no longer falls with the square of light, as a share of the mean.
const FLOOR: f64 = 0.02;

/// Variance as a share of the square of light, by neighbourhood: blocks of voxels and the axis that surfaces face along.
/// One value has one degree of freedom, so a neighbourhood with few of them leans on the larger one around it.
pub struct Local {
    grid: Grid,
    /// (W/m2)2, added to the square of light.
    floor: f64,
    blocks: [HashMap<u64, Sum>; 2],
    whole: Sum,
}

#[derive(Clone, Copy, Default)]
struct Sum {
    variance: f64,
    /// Of the squares of light.
    light: f64,
    count: f64,
}

impl Local {
    /// Without values yet; `mean` is the mean light, W/m2.
    pub fn new(grid: Grid, mean: f64) -> Local {
        Local { grid, floor: (FLOOR * mean).powi(2), blocks: Default::default(), whole: Sum::default() }
    }

    /// Adds the variance at a point that has `light`, for an `area`.
    pub fn add(&mut self, point: &SurfacePoint, area: f64, variance: f64, light: f64) {
        // A dark place may be off by much more than its light: of brighter ones around it that says no more than that they
        // may be off by theirs.
        let square = light * light + self.floor + variance.max(0.0);
        let own = Sum { variance: area * variance, light: area * square, count: 1.0 };
        self.whole.add(own);
        for level in 0..EDGES.len() {
            let key = self.key(point, level);
            self.blocks[level].entry(key).or_default().add(own);
        }
    }

    /// The variance at a point that has `light`; it may be below zero if some that were added were.
    pub fn variance(&self, point: &SurfacePoint, light: f64) -> f64 {
        let mut ratio = self.whole.ratio();
        for level in (0..EDGES.len()).rev() {
            if let Some(own) = self.blocks[level].get(&self.key(point, level)) {
                let prior = PRIOR * own.light / own.count;
                ratio = if own.light > 0.0 { (own.variance + prior * ratio) / (own.light + prior) } else { ratio };
            }
        }
        ratio * (light * light + self.floor)
    }

    fn key(&self, point: &SurfacePoint, level: usize) -> u64 {
        let axis = point.normal.abs().max_position();
        let side = 2 * axis as u64 + (point.normal[axis] < 0.0) as u64;
        let voxel = self.grid.voxel_of(point.position.as_dvec3());
        voxel.iter().fold(side, |key, x| key << 16 | (x / EDGES[level]) as u64)
    }
}

impl Sum {
    fn add(&mut self, other: Sum) {
        self.variance += other.variance;
        self.light += other.light;
        self.count += other.count;
    }

    fn ratio(&self) -> f64 {
        if self.light > 0.0 { self.variance / self.light } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;

    /// A variance far below the square of light.
    const SMALL: f64 = 1e-4;

    #[test]
    fn a_neighbourhood_with_many_values_speaks_for_itself_and_one_without_for_the_whole() {
        let grid = Grid { origin: DVec3::ZERO, voxel_size: 1.0, dims: [64, 64, 64] };
        let at = |x: f32| SurfacePoint { position: Vec3::new(x, 0.5, 0.5), normal: Vec3::Z };
        let mut local = Local::new(grid, 0.0);
        for _ in 0..200 {
            local.add(&at(1.0), 1.0, SMALL, 1.0);
            local.add(&at(33.0), 1.0, 0.25 * SMALL, 1.0);
        }
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.03;
        assert!(near(local.variance(&at(2.0), 1.0), SMALL / (1.0 + SMALL)));
        assert!(near(local.variance(&at(34.0), 1.0), 0.25 * SMALL));
        let all = 1.25 * SMALL / (2.0 + 1.25 * SMALL);
        assert!(near(local.variance(&at(60.0), 1.0), all));
        // Variance goes with the square of light, and sides are apart.
        assert!(near(local.variance(&at(2.0), 10.0), 100.0 * SMALL));
        let below = SurfacePoint { normal: Vec3::NEG_Z, ..at(2.0) };
        assert!(near(local.variance(&below, 1.0), all));
    }

    #[test]
    fn an_error_far_beyond_the_light_of_a_place_says_of_brighter_ones_that_theirs_is_in_doubt() {
        let grid = Grid { origin: DVec3::ZERO, voxel_size: 1.0, dims: [64, 64, 64] };
        let at = SurfacePoint { position: Vec3::ONE, normal: Vec3::Z };
        let mut local = Local::new(grid, 1.0);
        local.add(&at, 1.0, 1.0, 0.0);
        assert!(local.variance(&at, 1.0) <= 1.0 + FLOOR * FLOOR);
    }
}
