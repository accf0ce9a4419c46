//! Which patches vertices take their light from, found out by one process or by many.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::prepared::Prepared;
use crate::{
    BakeOptions,
    options::PatchSource,
    reconstruct::{Field, Level, PatchIndex},
    simplify::Simplified,
    trace::RayTracer,
};

/// What vertices see of the patches depends on this, besides patches and surfaces.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Sight {
    /// Patches that are not hidden.
    pub known: Vec<bool>,
    /// How far patches reach to either side of their centroid, in voxels; empty if that says nothing of the surfaces.
    #[serde(with = "crate::lxt::raw")]
    depth: Vec<f32>,
    /// Which of the scene's triangles receive light on both sides.
    two_sided: Vec<bool>,
}

impl Sight {
    /// Of patches of which these are `known`.
    pub(super) fn new(prepared: &Prepared, known: Vec<bool>, options: &BakeOptions) -> Sight {
        let real = options.patches == PatchSource::Surfels;
        let depth = if real { Level::new(&prepared.simplified).depth().to_vec() } else { Vec::new() };
        Sight { known, depth, two_sided: prepared.scene.triangles.iter().map(|t| t.two_sided).collect() }
    }

    /// Whether it is of so many patches, of so many surfaces.
    pub(crate) fn fits(&self, patches: usize, triangles: usize) -> bool {
        let Sight { known, depth, two_sided } = self;
        known.len() == patches && [0, patches].contains(&depth.len()) && two_sided.len() == triangles
    }

    /// Calls `then` with a field without values; `tracer` holds the scene's surfaces.
    pub(crate) fn in_field<R>(
        mut self,
        simplified: &Simplified,
        tracer: &dyn RayTracer,
        options: &BakeOptions,
        then: impl FnOnce(&Field) -> R,
    ) -> R {
        let (index, normals) = (PatchIndex::new(&simplified.patches, simplified.grid), simplified.normals());
        let level = self.take_level(simplified.grid.voxel_size);
        then(&self.field(simplified, &index, tracer, &normals, &level, options))
    }

    /// How far patches reach to either side of their centroid: it is not here any more then.
    pub(super) fn take_level(&mut self, voxel_size: f64) -> Level {
        Level::of(std::mem::take(&mut self.depth), voxel_size)
    }

    /// A field without values; `tracer` holds the scene's surfaces, whose unit normals are `normals`.
    pub(super) fn field<'a>(
        &'a self,
        simplified: &'a Simplified,
        index: &'a PatchIndex,
        tracer: &'a dyn RayTracer,
        normals: &'a [Vec3],
        level: &'a Level,
        options: &BakeOptions,
    ) -> Field<'a> {
        Field {
            simplified,
            index,
            values: &[],
            known: &self.known,
            tracer,
            normals,
            two_sided: &self.two_sided,
            cos_threshold: options.normal_threshold.to_radians().cos(),
            senders: None,
            level,
            stencils: None,
        }
    }
}
