//! From patches back to vertices and points (step 5 of the paper, and a better one).

mod edges;
mod factors;
mod gather;
mod index;
mod level;
mod nearest4;
mod smooth;
mod stencils;

pub use edges::clear_of_walls;
pub use factors::Factors;
pub use gather::Senders;
pub use index::PatchIndex;
pub use level::Level;
pub use stencils::{Neighbour, Stencils};

use gather::Gather;
use glam::Vec3;
use rayon::prelude::*;

use crate::{
    options::Reconstruct,
    scene::SurfacePoint,
    simplify::{Patches, Simplified},
    trace::RayTracer,
};

/// What interpolation works on.
pub struct Field<'a> {
    /// The patches, their grid and surfaces.
    pub simplified: &'a Simplified,
    /// Finds patches near a point.
    pub index: &'a PatchIndex,
    /// The value of each patch: irradiance, W/m2.
    pub values: &'a [Vec3],
    /// Patches whose value is known; the others are left out.
    pub known: &'a [bool],
    /// Tracer of the real surfaces.
    pub tracer: &'a dyn RayTracer,
    /// Unit normals of the triangles that `tracer` holds.
    pub normals: &'a [Vec3],
    /// Which of them receive light on both sides.
    pub two_sided: &'a [bool],
    /// Cosine of the largest angle between the normals of a point and a patch.
    pub cos_threshold: f32,
    /// What the rays of gathering points meet; without it, points interpolate.
    pub senders: Option<Senders<'a>>,
    /// Where patches are visible without asking.
    pub level: &'a Level,
    /// Which patches some points see, where that was found out before.
    pub stencils: Option<&'a Stencils>,
}

impl Field<'_> {
    fn patches(&self) -> &Patches {
        &self.simplified.patches
    }
}

/// Points of a unit of parallel work.
const CHUNK: usize = 64;
/// Units that are not shared out further: few, for their cost differs.
const PIECE: usize = 4;

/// Carries the field to `points`. Values are never negative. The result of a point depends on nothing but its
/// position and normal; it is zero if these are not finite or the normal is not a unit vector.
pub fn interpolate(field: &Field, method: Reconstruct, points: &[SurfacePoint]) -> Vec<Vec3> {
    let gather = match method {
        Reconstruct::Gather | Reconstruct::Adaptive => {
            field.senders.as_ref().map(|senders| Gather::new(field, senders))
        }
        Reconstruct::Smooth | Reconstruct::Nearest4 => None,
    };
    points
        .par_chunks(CHUNK)
        .with_max_len(PIECE)
        .flat_map_iter(|chunk| match (method, &gather) {
            (Reconstruct::Nearest4, _) => chunk.iter().map(|p| nearest4::interpolate(field, p)).collect(),
            (Reconstruct::Gather, Some(gather)) => everywhere(field, gather, chunk),
            (Reconstruct::Adaptive, Some(gather)) => where_asked(field, gather, chunk),
            _ => smooth::interpolate(field, chunk).into_iter().map(|fit| fit.value).collect(),
        })
        .collect()
}

/// Where [`Reconstruct::Adaptive`] gathers: the patches near a point differ, or lie to one side of it.
pub fn in_doubt(field: &Field, points: &[SurfacePoint]) -> Vec<bool> {
    let of_chunk = |chunk| smooth::interpolate(field, chunk).into_iter().map(|fit| fit.is_doubtful());
    points.par_chunks(CHUNK).with_max_len(PIECE).flat_map_iter(of_chunk).collect()
}

/// Gathers at every point, and interpolates where no ray starts in the open.
fn everywhere(field: &Field, gather: &Gather, points: &[SurfacePoint]) -> Vec<Vec3> {
    let gathered = gather.light(points);
    let lost: Vec<SurfacePoint> = points.iter().zip(&gathered).filter(|g| g.1.is_none()).map(|g| *g.0).collect();
    let mut instead = smooth::interpolate(field, &lost).into_iter();
    gathered.into_iter().map(|e| e.or_else(|| Some(instead.next()?.value)).unwrap_or_default()).collect()
}

/// Interpolates, and gathers where the fit is in doubt.
fn where_asked(field: &Field, gather: &Gather, points: &[SurfacePoint]) -> Vec<Vec3> {
    let fits = smooth::interpolate(field, points);
    let asking: Vec<SurfacePoint> =
        points.iter().zip(&fits).filter(|(_, fit)| fit.is_doubtful()).map(|(p, _)| *p).collect();
    let mut gathered = gather.light(&asking).into_iter();
    fits.iter()
        .map(|fit| if fit.is_doubtful() { gathered.next().flatten().unwrap_or(fit.value) } else { fit.value })
        .collect()
}
