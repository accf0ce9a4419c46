//! The geometry simplification: surfaces are cut by voxels and the pieces grouped into patches.

use glam::Vec3;

/// The patches of the radiosity system, structure of arrays; local units.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    /// Area.
    pub area: Vec<f32>,
    /// Area-weighted mean position.
    pub centroid: Vec<Vec3>,
    /// Unit mean normal.
    pub normal: Vec<Vec3>,
    /// Mean albedo.
    pub albedo: Vec<Vec3>,
    /// Mean emitted exitance, W/m2.
    pub emitted: Vec<Vec3>,
    /// Voxel.
    pub voxel: Vec<[i32; 3]>,
}

impl Patches {
    /// Number of patches.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }
}

/// The surfaces cut by the voxels, as a triangle mesh; vertices of equal position and normal are one.
#[derive(Clone, Debug, Default)]
pub struct SplitMesh {
    /// Vertex positions, local.
    pub positions: Vec<Vec3>,
    /// Unit shading normals.
    pub normals: Vec<Vec3>,
    /// Albedo at the vertices.
    pub albedo: Vec<Vec3>,
    /// Vertex indices. Two-sided surfaces appear once for each side that light reaches.
    pub triangles: Vec<[u32; 3]>,
    /// Scene triangle that each triangle is a piece of.
    pub source: Vec<u32>,
    /// Patch that each triangle belongs to (`PatchSource::Surfels`; else `u32::MAX`).
    pub patch: Vec<u32>,
}
