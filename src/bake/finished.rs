//! A finished bake, and what can be asked of it.

use glam::Vec3;

use super::{exchange::add, tracers::Tracers};
use crate::{
    BakeOptions,
    estimate::VertexError,
    light::{self, AS_GOOD, Crowd, DirectResult, Known, LightSet},
    options::Reconstruct,
    progress::{Progress, Silent},
    reconstruct::{self, Field, PatchIndex, Senders, Stencils},
    report::Report,
    scene::SurfacePoint,
    simplify::{NO_PATCH, Patches, Simplified, SplitMesh},
    skip::Foresight,
    trace::{Hit, RayTracer},
    transfer::FormFactors,
};

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
    /// Reflected radiosity, W/m2; emission is not in it.
    pub radiosity: Vec<Vec3>,
    /// Whether light reaches the patch at all.
    pub reached: Vec<bool>,
    /// Whether the patch has a value: not if all of it lies hidden inside or behind objects.
    pub known: Vec<bool>,
}

/// Points that are lit at once.
const BLOCK: usize = 1 << 14;

/// A finished bake.
pub struct Bake {
    /// The surfaces cut by the voxels.
    pub mesh: SplitMesh,
    /// Light at the vertices of `mesh`.
    pub vertices: Irradiance,
    /// The patches and the surfaces that they stand for.
    pub simplified: Simplified,
    /// Form factors between the patches.
    pub form_factors: FormFactors,
    /// Light of the patches.
    pub light: PatchLight,
    /// What was measured.
    pub report: Report,
    /// Standard error of the light at the vertices of `mesh`; `None` if none was asked for.
    pub error: Option<VertexError>,
    pub(crate) options: BakeOptions,
    pub(crate) lights: LightSet,
    /// Bright patches, whose first reflection lights vertices and points as lamps do.
    pub(crate) bright: Option<LightSet>,
    /// Irradiance of the patches straight from emitting patches; `None` where emitters are sampled as lights.
    pub(crate) glow: Option<Vec<Vec3>>,
    /// Indirect irradiance of the patches without what the bright ones send.
    pub(crate) smooth: Vec<Vec3>,
    /// Radiosity of the patches that goes on by form factors, W/m2.
    pub(crate) carried: Vec<Vec3>,
    /// Which patches some points take their light from, where that was found out before.
    pub(crate) stencils: Option<Stencils>,
    pub(super) foresight: Foresight,
    pub(super) index: PatchIndex,
    /// Normals of the scene's triangles.
    pub(super) normals: Vec<Vec3>,
    /// Which of the scene's triangles receive light on both sides.
    pub(super) two_sided: Vec<bool>,
    pub(super) tracers: Tracers,
}

impl SurfacePoint {
    /// Whether the position is finite and the normal a unit vector.
    pub(crate) fn is_sound(&self) -> bool {
        self.position.is_finite() && (self.normal.length_squared() - 1.0).abs() < 0.01
    }
}

impl Bake {
    /// The patches.
    pub fn patches(&self) -> &Patches {
        &self.simplified.patches
    }

    /// The tracer of the scene's surfaces.
    pub fn tracer(&self) -> &dyn RayTracer {
        self.tracers.surfaces()
    }

    /// The tracer that [`Bake::patch_of`] understands: that of the surfaces, or of what stands for
    /// them.
    pub fn patch_tracer(&self) -> &dyn RayTracer {
        self.tracers.patches()
    }

    /// The patch that a ray of [`Bake::patch_tracer`] met; `None` if nothing or the inside of an object.
    pub fn patch_of(&self, hit: &Hit) -> Option<u32> {
        if !hit.is_hit() {
            return None;
        }
        let patch = self.simplified.hit_map.patch(&self.simplified.fragments, hit);
        (patch != NO_PATCH).then_some(patch)
    }

    /// Radiance of the sky in a direction that meets no surface, W/m2/sr.
    pub fn sky_radiance(&self, direction: Vec3) -> Vec3 {
        self.lights.sky_radiance(direction)
    }

    /// Irradiance at surface points of the scene. The light of a point depends on nothing but the point itself; it is
    /// zero where the point is not finite or its normal is not a unit vector. Points in the edges of the mesh are lit
    /// from slightly inside of the room.
    pub fn irradiance(&self, points: &[SurfacePoint], progress: &dyn Progress) -> Irradiance {
        self.irradiance_with(points, self.options.point_samples, progress)
    }

    /// As [`Bake::irradiance`], with another number of shadow rays a point.
    pub fn irradiance_with(&self, points: &[SurfacePoint], samples: u32, progress: &dyn Progress) -> Irradiance {
        let points = reconstruct::clear_of_walls(self.tracer(), &self.normals, points);
        self.light(&points, samples, progress)
    }

    /// As [`Bake::irradiance`], for pictures: what very many bright patches send is that of [`Bake::crowd`], if there is one.
    pub(crate) fn seen(&self, points: &[SurfacePoint], crowd: Option<&Crowd>) -> Irradiance {
        let points = reconstruct::clear_of_walls(self.tracer(), &self.normals, points);
        self.light_with(&points, self.options.point_samples, crowd, &Silent)
    }

    /// The bright patches, if there are more of them than a point can look at one by one.
    pub(crate) fn crowd(&self) -> Option<Crowd> {
        self.bright.as_ref().and_then(Crowd::of_polygons)
    }

    /// Changes how light is carried to the points that are asked for from now on; `vertices` stay as they are.
    pub fn set_reconstruct(&mut self, method: Reconstruct, gather_rays: u32) {
        self.options.reconstruct = method;
        self.options.gather_rays = gather_rays;
    }

    /// Light at points that stand clear of walls.
    pub(super) fn light(&self, points: &[SurfacePoint], samples: u32, progress: &dyn Progress) -> Irradiance {
        self.light_with(points, samples, None, progress)
    }

    fn light_with(
        &self,
        points: &[SurfacePoint],
        samples: u32,
        crowd: Option<&Crowd>,
        progress: &dyn Progress,
    ) -> Irradiance {
        progress.begin("points", points.len() as u64);
        let mut all = Irradiance::default();
        for block in points.chunks(BLOCK) {
            if progress.stopped() {
                all.direct.resize(points.len(), Vec3::ZERO);
                all.indirect.resize(points.len(), Vec3::ZERO);
                break;
            }
            let counted = |result: DirectResult| {
                self.foresight.count(&result);
                result.irradiance
            };
            let lit = |lights: &LightSet| counted(self.sampled(lights, block, samples, self.options.seed));
            let glow = self.glow.as_ref().map(|glow| self.interpolate(block, glow, &self.patches().emitted));
            all.direct.extend(add(lit(&self.lights), glow));
            let smooth = self.interpolate(block, &self.smooth, &self.carried);
            let bright = match crowd {
                Some(crowd) => {
                    let samples = samples.max(AS_GOOD);
                    Some(counted(crowd.irradiance(self.tracer(), block, 1, samples, self.options.seed)))
                }
                None => self.bright.as_ref().map(lit),
            };
            all.indirect.extend(add(smooth, bright));
            progress.advance(block.len() as u64);
        }
        progress.end();
        all
    }

    /// Light of `lights` at points that stand clear of walls, by shadow rays.
    pub(crate) fn sampled(&self, lights: &LightSet, points: &[SurfacePoint], samples: u32, seed: u64) -> DirectResult {
        let view = |points: &[SurfacePoint]| self.foresight.of_point(&self.simplified, &self.index, points);
        let known = Known { view: &view, skip: self.foresight.on, census: None };
        light::irradiance_where(lights, self.tracer(), points, 1, samples, seed, &known)
    }

    /// Carries `values` of the patches to points that stand clear of walls; `exitance` is what the values are the light of.
    pub(crate) fn interpolate(&self, points: &[SurfacePoint], values: &[Vec3], exitance: &[Vec3]) -> Vec<Vec3> {
        reconstruct::interpolate(&self.field(values, exitance), self.options.reconstruct, points)
    }

    /// Values of the patches as a field.
    pub(crate) fn field<'a>(&'a self, values: &'a [Vec3], exitance: &'a [Vec3]) -> Field<'a> {
        Field {
            simplified: &self.simplified,
            index: &self.index,
            values,
            known: &self.light.known,
            tracer: self.tracer(),
            normals: &self.normals,
            two_sided: &self.two_sided,
            cos_threshold: self.options.normal_threshold.to_radians().cos(),
            senders: Some(Senders {
                tracer: self.patch_tracer(),
                exitance,
                closed: self.form_factors.is_closed(),
                displaced: self.tracers.faces.is_some(),
                rays: self.options.gather_rays,
                seed: self.options.seed,
            }),
            level: &self.foresight.level,
            stencils: self.stencils.as_ref(),
        }
    }
}
