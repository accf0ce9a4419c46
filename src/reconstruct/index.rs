//! Which patches are near a point.

use std::ops::Range;

use glam::Vec3;

use crate::simplify::{Grid, Patches};

/// Patches by voxel: they are sorted in raster order with z fastest, so that a column of voxels is one run.
pub struct PatchIndex {
    grid: Grid,
    /// Where the patches of column (x, y) begin; one more entry than columns.
    columns: Vec<u32>,
    /// z of each patch's voxel.
    z: Vec<u16>,
    /// The centroids of the patches, by axis.
    centroid: [Vec<f32>; 3],
}

/// Patches whose distances are computed at once.
const LANES: usize = 16;
/// What is within a radius by somebody else's rounding is within this multiple of it by ours.
const SLACK: f32 = 1.0001;

impl PatchIndex {
    /// Indexes `patches`, which are sorted by voxel and stay where they are.
    pub fn new(patches: &Patches, grid: Grid) -> PatchIndex {
        let count = grid.dims[0] as usize * grid.dims[1] as usize;
        let mut columns = vec![0u32; count + 1];
        for &voxel in &patches.voxel {
            columns[(voxel / grid.dims[2] as u64) as usize + 1] += 1;
        }
        for c in 0..count {
            columns[c + 1] += columns[c];
        }
        let z = patches.voxel.iter().map(|v| (v % grid.dims[2] as u64) as u16).collect();
        let centroid = std::array::from_fn(|axis| patches.centroid.iter().map(|c| c[axis]).collect());
        PatchIndex { grid, columns, z, centroid }
    }

    /// Calls `visit` for every patch whose voxel meets the cube of half-edge `radius` (in voxels) about `p`.
    pub fn near(&self, p: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
        self.runs(p, radius).for_each(|run| run.for_each(&mut visit));
    }

    /// Whether `holds` is true of every patch whose voxel meets the cube of half-edge `radius` (in voxels) about `p`.
    pub fn all_near(&self, p: Vec3, radius: f32, mut holds: impl FnMut(usize) -> bool) -> bool {
        self.runs(p, radius).all(|mut run| run.all(&mut holds))
    }

    /// Calls `visit`, in the order of their numbers, for every patch whose centroid is within `radius` (in voxels) of
    /// `p`, and for some that are farther by rounding.
    pub fn within(&self, p: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
        let radius = SLACK * radius;
        let limit = (radius * self.grid.voxel_size as f32).powi(2);
        let [x, y, z] = self.centroid.each_ref().map(Vec::as_slice);
        for run in self.runs(p, radius) {
            for begin in run.clone().step_by(LANES) {
                let end = run.end.min(begin + LANES);
                let mut found = 0u32;
                let lanes = x[begin..end].iter().zip(&y[begin..end]).zip(&z[begin..end]).enumerate();
                for (lane, ((&x, &y), &z)) in lanes {
                    let d = [x - p.x, y - p.y, z - p.z];
                    found |= u32::from(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= limit) << lane;
                }
                while found != 0 {
                    visit(begin + found.trailing_zeros() as usize);
                    found &= found - 1;
                }
            }
        }
    }

    /// The patches whose voxels meet the cube of half-edge `radius` (in voxels) about `p`, as ranges in ascending order.
    fn runs(&self, p: Vec3, radius: f32) -> impl Iterator<Item = Range<usize>> {
        let reach = radius as f64 * self.grid.voxel_size;
        let (low, high) = (self.grid.voxel_of(p.as_dvec3() - reach), self.grid.voxel_of(p.as_dvec3() + reach));
        let columns = (low[0]..=high[0]).flat_map(move |x| (low[1]..=high[1]).map(move |y| (x, y)));
        columns.map(move |(x, y)| {
            let column = (x * self.grid.dims[1] + y) as usize;
            let (begin, end) = (self.columns[column] as usize, self.columns[column + 1] as usize);
            let z = &self.z[begin..end];
            let first = z.partition_point(|&z| (z as u32) < low[2]);
            let last = z.partition_point(|&z| (z as u32) <= high[2]);
            begin + first..begin + last
        })
    }

    /// Half-edge, in voxels, of a cube that certainly holds all patches.
    pub fn whole(&self) -> f32 {
        self.grid.dims.into_iter().max().unwrap_or(1) as f32 + 1.0
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = Vec3> {
        proptest::array::uniform3(-1.0_f32..9.0).prop_map(Vec3::from_array)
    }

    proptest! {
        #[test]
        fn a_search_finds_what_a_look_at_all_finds(
            mut centroid in proptest::collection::vec(point(), 0..400),
            p in point(),
            radius in 0.1_f32..3.0,
        ) {
            let grid = Grid { origin: DVec3::ZERO, voxel_size: 1.25, dims: [7, 6, 8] };
            let size = grid.dims.map(|n| n as f32 * 1.25 - 1e-3);
            centroid.iter_mut().for_each(|c| *c = c.clamp(Vec3::ZERO, size.into()));
            centroid.sort_by_key(|c| grid.raster(grid.voxel_of(c.as_dvec3())));
            let voxel = centroid.iter().map(|c| grid.raster(grid.voxel_of(c.as_dvec3()))).collect();
            let index = PatchIndex::new(&Patches { centroid: centroid.clone().into(), voxel, ..Patches::default() }, grid);

            let distance = |j: usize| centroid[j].distance(p) / (1.25 * radius);
            let (mut within, mut near, mut asked) = (vec![], vec![], vec![]);
            index.within(p, radius, |j| within.push(j));
            index.near(p, radius, |j| near.push(j));
            let all = index.all_near(p, radius, |j| {
                asked.push(j);
                true
            });
            prop_assert!(all);
            prop_assert!(within.is_sorted() && within.iter().all(|&j| distance(j) < 1.001));
            for j in (0..centroid.len()).filter(|&j| distance(j) < 1.0) {
                prop_assert!(within.contains(&j) && near.contains(&j));
            }
            prop_assert_eq!(asked, near);
        }
    }
}
