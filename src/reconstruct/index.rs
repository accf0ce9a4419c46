//! Which patches are near a point.

use glam::Vec3;

use crate::simplify::{Grid, Patches};

/// Patches by voxel: they are sorted in raster order with z fastest, so that a column of voxels is one run.
pub struct PatchIndex {
    grid: Grid,
    /// Where the patches of column (x, y) begin; one more entry than columns.
    columns: Vec<u32>,
    /// z of each patch's voxel.
    z: Vec<u16>,
}

impl PatchIndex {
    /// Indexes `patches`, which are sorted by voxel.
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
        PatchIndex { grid, columns, z }
    }

    /// Calls `visit` for every patch whose voxel meets the cube of half-edge `radius` (in voxels) about `p`.
    pub fn near(&self, p: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
        let reach = radius as f64 * self.grid.voxel_size;
        let (low, high) = (self.grid.voxel_of(p.as_dvec3() - reach), self.grid.voxel_of(p.as_dvec3() + reach));
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                let column = (x * self.grid.dims[1] + y) as usize;
                let (begin, end) = (self.columns[column] as usize, self.columns[column + 1] as usize);
                let z = &self.z[begin..end];
                let first = z.partition_point(|&z| (z as u32) < low[2]);
                let last = z.partition_point(|&z| (z as u32) <= high[2]);
                (begin + first..begin + last).for_each(&mut visit);
            }
        }
    }

    /// Half-edge, in voxels, of a cube that certainly holds all patches.
    pub fn whole(&self) -> f32 {
        self.grid.dims.into_iter().max().unwrap_or(1) as f32 + 1.0
    }
}
