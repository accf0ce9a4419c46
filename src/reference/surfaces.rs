//! The surfaces of a scene as paths meet them.

use glam::{Vec3, Vec3A};

use super::lamps::NO_LAMP;
use crate::{Scene, scene::RAY_OFFSET, trace::Hit};

/// Share of the way to the middle of its triangle that a hit is moved: more than rounding, so that a path that meets
/// an inner edge does not go on behind the wall beside it.
const INWARDS: f32 = 1.0 / (1 << 20) as f32;

/// One triangle, in one cache line.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Surface {
    normal: Vec3A,
    /// Middle times [`INWARDS`].
    pull: Vec3A,
    /// Where it is the same everywhere.
    albedo: Vec3A,
    /// normal . position of its plane.
    offset: f32,
    textured: bool,
    two_sided: bool,
    /// Lamps of the front and the back.
    lamps: [u32; 2],
}

/// All triangles.
pub(super) struct Surfaces<'a> {
    scene: &'a Scene,
    of_triangle: Vec<Surface>,
}

/// Where a path met a surface that reflects.
pub(super) struct Met {
    /// Where the next ray starts: off the surface.
    pub origin: Vec3A,
    /// Unit normal of the side that was met.
    pub normal: Vec3A,
    /// Reflectance there.
    pub albedo: Vec3A,
}

impl<'a> Surfaces<'a> {
    /// `lamps`: of the front and back of every triangle, [`NO_LAMP`] where it does not glow.
    pub fn new(scene: &'a Scene, lamps: &[[u32; 2]]) -> Surfaces<'a> {
        let surface = |t: usize| {
            let corners = scene.corners_of(t);
            let normal = scene.normal(t);
            let albedo = scene.constant_albedo(t);
            let offset = normal.as_dvec3().dot(corners[0].as_dvec3()) as f32;
            Surface {
                normal: normal.into(),
                offset,
                pull: ((corners[0] + corners[1] + corners[2]) / 3.0 * INWARDS).into(),
                albedo: albedo.map_or(Vec3::ZERO, |a| a.clamp(Vec3::ZERO, Vec3::ONE)).into(),
                textured: albedo.is_none(),
                two_sided: scene.triangles[t].two_sided,
                lamps: lamps[t],
            }
        };
        Surfaces { scene, of_triangle: (0..scene.triangles.len()).map(surface).collect() }
    }

    /// The lamp that a ray met, with the cosine (times the ray's length) at which it left; none on a dark side.
    #[inline]
    pub fn lamp(&self, hit: &Hit, direction: Vec3A) -> Option<(u32, f32)> {
        let surface = &self.of_triangle[hit.triangle()];
        let lamp = surface.lamps[hit.is_back() as usize];
        (lamp != NO_LAMP).then(|| (lamp, surface.normal.dot(direction).abs()))
    }

    /// The vertex of a path where a ray met a surface; none on the back of a one-sided one.
    #[inline]
    pub fn met(&self, hit: &Hit, origin: Vec3A, direction: Vec3A) -> Option<Met> {
        let surface = &self.of_triangle[hit.triangle()];
        if hit.is_back() && !surface.two_sided {
            return None;
        }
        let near = origin + hit.t * direction;
        let near = near * (1.0 - INWARDS) + surface.pull;
        // Onto the plane, and off it to the side that was met: rounding of far hits is more than the offset.
        let side = if hit.is_back() { -1.0 } else { 1.0 };
        let height = surface.offset - surface.normal.dot(near) + side * RAY_OFFSET;
        let albedo =
            if surface.textured { self.scene.albedo(hit.triangle(), hit.u, hit.v).into() } else { surface.albedo };
        Some(Met { origin: near + height * surface.normal, normal: side * surface.normal, albedo })
    }
}
