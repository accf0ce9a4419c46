//! The program: one line a stage, in the order of the paper's algorithm.

use glam::Vec3;

use crate::{
    BakeOptions, Result, Scene,
    progress::Progress,
    report::Report,
    simplify::{Patches, SplitMesh},
    trace::{Hit, RayTracer},
};

/// A point of a surface that receives light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, local.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}

/// Irradiance, W/m2, one entry a point.
#[derive(Clone, Debug, Default)]
pub struct Irradiance {
    /// Straight from lights.
    pub direct: Vec<Vec3>,
    /// After at least one reflection.
    pub indirect: Vec<Vec3>,
}

/// Light of the patches.
#[derive(Clone, Debug, Default)]
pub struct PatchLight {
    /// Direct irradiance, W/m2.
    pub direct: Vec<Vec3>,
    /// Indirect irradiance, W/m2.
    pub indirect: Vec<Vec3>,
    /// Radiosity (exitance without emission where `Primary::Direct`), W/m2.
    pub radiosity: Vec<Vec3>,
    /// Whether light reaches the patch at all.
    pub reached: Vec<bool>,
}

/// A finished bake.
pub struct Bake {
    /// The surfaces cut by the voxels.
    pub mesh: SplitMesh,
    /// Light at the vertices of `mesh`.
    pub vertices: Irradiance,
    /// The patches.
    pub patches: Patches,
    /// Light of the patches.
    pub light: PatchLight,
    /// What was measured.
    pub report: Report,
    tracer: Box<dyn RayTracer>,
}

impl Bake {
    /// The tracer of the scene's surfaces.
    pub fn tracer(&self) -> &dyn RayTracer {
        &*self.tracer
    }

    /// The tracer that [`Bake::patch_of`] understands: that of the surfaces, or of the voxel faces.
    pub fn patch_tracer(&self) -> &dyn RayTracer {
        &*self.tracer
    }

    /// The patch that a ray of [`Bake::patch_tracer`] met.
    pub fn patch_of(&self, _hit: &Hit) -> Option<u32> {
        None
    }

    /// Irradiance at surface points (used for `luxel points` and for the pixels of the preview).
    pub fn irradiance(&self, _points: &[SurfacePoint], _progress: &dyn Progress) -> Irradiance {
        Irradiance::default()
    }
}

/// Bakes a scene.
///
/// # Errors
/// No light at all, a backend that is not there, options without sense.
pub fn bake(scene: &Scene, options: &BakeOptions, progress: &dyn Progress) -> Result<Bake> {
    let _ = (scene, options, progress);
    Err(crate::Error::Scene("not built yet".into()))
}
