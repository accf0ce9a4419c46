//! Ray queries: one batch-first trait, several backends with the same answers.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::{Error, Result, options::Backend};

mod brute;
mod bvh;
#[cfg(feature = "embree")]
mod embree;
mod wide;

pub use brute::Brute;
pub use bvh::Bvh;
#[cfg(feature = "embree")]
pub use embree::Embree;

/// Triangles to trace, in any unit. Triangle ids are positions in `triangles`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Geometry {
    /// Vertex positions; all finite.
    #[serde(with = "crate::lxt::raw")]
    pub positions: Vec<Vec3>,
    /// Vertex indices; all in range. At most 2^31 - 1 triangles.
    #[serde(with = "crate::lxt::raw")]
    pub triangles: Vec<[u32; 3]>,
}

impl Geometry {
    /// Looks for what no backend can trace.
    ///
    /// # Errors
    /// [`Error::Backend`] naming the first vertex that is not finite, or triangle that has no such vertex.
    pub fn check(&self) -> Result<()> {
        if self.triangles.len() >= 1 << 31 {
            return Err(Error::Backend(format!("{} triangles: at most 2^31 - 1 can be traced", self.triangles.len())));
        }
        if let Some(i) = self.positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Backend(format!("vertex {i} is not finite: {}", self.positions[i])));
        }
        let n = self.positions.len();
        if let Some(i) = self.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
            return Err(Error::Backend(format!("triangle {i} has vertices {:?} of {n}", self.triangles[i])));
        }
        Ok(())
    }
}

/// Rays as a structure of arrays, so that packets load without shuffling.
///
/// A ray meets a triangle at distance t where `t_min < t < t_max` (t in units of |direction|).
#[derive(Clone, Debug, Default)]
pub struct RayBatch {
    /// Origins, x.
    pub origin_x: Vec<f32>,
    /// Origins, y.
    pub origin_y: Vec<f32>,
    /// Origins, z.
    pub origin_z: Vec<f32>,
    /// Directions, x; need not be unit vectors.
    pub direction_x: Vec<f32>,
    /// Directions, y.
    pub direction_y: Vec<f32>,
    /// Directions, z.
    pub direction_z: Vec<f32>,
    /// Distances that count are beyond this; at least 0.
    pub t_min: Vec<f32>,
    /// Distances that count are below this.
    pub t_max: Vec<f32>,
    /// Whether neighbouring rays have like origins and directions: packets may then be traced as one.
    pub coherent: bool,
}

impl RayBatch {
    /// An empty batch with room for `capacity` rays.
    pub fn with_capacity(capacity: usize) -> RayBatch {
        let v = || Vec::with_capacity(capacity);
        RayBatch {
            origin_x: v(),
            origin_y: v(),
            origin_z: v(),
            direction_x: v(),
            direction_y: v(),
            direction_z: v(),
            t_min: v(),
            t_max: v(),
            coherent: false,
        }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.origin_x.len()
    }

    /// Whether there are no rays.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Removes all rays, keeps the memory.
    pub fn clear(&mut self) {
        self.resize(0);
    }

    /// Sets the number of rays; new ones are zero.
    pub fn resize(&mut self, n: usize) {
        for v in self.arrays_mut() {
            v.resize(n, 0.0);
        }
    }

    /// Copies the rays in `from` to `to` and after.
    pub fn copy_within(&mut self, from: std::ops::Range<usize>, to: usize) {
        for v in self.arrays_mut() {
            v.copy_within(from.clone(), to);
        }
    }

    /// Appends one ray.
    pub fn push(&mut self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) {
        self.origin_x.push(origin.x);
        self.origin_y.push(origin.y);
        self.origin_z.push(origin.z);
        self.direction_x.push(direction.x);
        self.direction_y.push(direction.y);
        self.direction_z.push(direction.z);
        self.t_min.push(t_min);
        self.t_max.push(t_max);
    }

    /// Origin of ray `i`.
    pub fn origin(&self, i: usize) -> Vec3 {
        Vec3::new(self.origin_x[i], self.origin_y[i], self.origin_z[i])
    }

    /// Direction of ray `i`.
    pub fn direction(&self, i: usize) -> Vec3 {
        Vec3::new(self.direction_x[i], self.direction_y[i], self.direction_z[i])
    }

    /// x, y and z of the origins.
    pub fn origins_mut(&mut self) -> [&mut [f32]; 3] {
        [&mut self.origin_x, &mut self.origin_y, &mut self.origin_z]
    }

    /// x, y and z of the directions.
    pub fn directions_mut(&mut self) -> [&mut [f32]; 3] {
        [&mut self.direction_x, &mut self.direction_y, &mut self.direction_z]
    }

    fn arrays_mut(&mut self) -> [&mut Vec<f32>; 8] {
        [
            &mut self.origin_x,
            &mut self.origin_y,
            &mut self.origin_z,
            &mut self.direction_x,
            &mut self.direction_y,
            &mut self.direction_z,
            &mut self.t_min,
            &mut self.t_max,
        ]
    }
}

/// What a ray met first.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Hit {
    /// Distance in units of |direction|.
    pub t: f32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub v: f32,
    /// `triangle * 2 + side`, side 1 when the back was hit (the normal is (v1-v0) x (v2-v0)); [`MISS`] if nothing was.
    pub face: u32,
}

/// [`Hit::face`] of a ray that met nothing.
pub const MISS: u32 = u32::MAX;

impl Hit {
    /// No hit.
    pub const NONE: Hit = Hit { t: f32::INFINITY, u: 0.0, v: 0.0, face: MISS };

    /// Whether the ray met something.
    pub fn is_hit(&self) -> bool {
        self.face != MISS
    }

    /// The triangle; only meaningful after [`Hit::is_hit`].
    pub fn triangle(&self) -> usize {
        (self.face >> 1) as usize
    }

    /// Whether the back of the triangle was met.
    pub fn is_back(&self) -> bool {
        self.face & 1 == 1
    }
}

/// A committed scene that answers ray queries, from any number of threads.
///
/// Every backend honours `t_min` and `t_max`, never reports NaN, and gives the same answer for a ray whatever else
/// is in its batch; but where two triangles are met at the same distance, a `coherent` batch may tell either.
/// A ray that is not finite or has no direction meets nothing; one that starts 1e18 times the size of the scene away
/// may meet nothing. All arrays of a batch and its results must have one
/// length; a backend may panic where they have not.
pub trait RayTracer: Send + Sync {
    /// Name and version, e.g. `embree 3.13.5`.
    fn name(&self) -> String;

    /// The processor's instructions that it runs on, e.g. `AVX2`.
    fn instruction_set(&self) -> String {
        // What this crate was compiled for.
        let sets = [("AVX-512", cfg!(target_feature = "avx512f")), ("AVX2", cfg!(target_feature = "avx2"))];
        let baseline = [("SSE2", cfg!(target_feature = "sse2")), ("NEON", cfg!(target_feature = "neon"))];
        let found = sets.into_iter().chain(baseline).find(|&(_, compiled)| compiled);
        found.map_or("scalar", |(name, _)| name).into()
    }

    /// Whether successive rays of a `coherent` batch are traced together: the more alike they are, the faster.
    fn traces_packets(&self) -> bool {
        false
    }

    /// The nearest hit of every ray. `hits` has the length of `rays`.
    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]);

    /// Whether anything lies on the ray. `occluded` has the length of `rays`.
    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]);
}

/// Builds the tracer that `backend` asks for.
///
/// # Errors
/// [`Error::Backend`] if the backend is not compiled in or could not be built.
pub fn build(backend: Backend, geometry: &Geometry) -> Result<Box<dyn RayTracer>> {
    match backend {
        #[cfg(feature = "embree")]
        Backend::Auto | Backend::Embree => Ok(Box::new(Embree::new(geometry)?)),
        #[cfg(not(feature = "embree"))]
        Backend::Embree => {
            Err(Error::Backend("this build has no embree: build with --features embree, or use --backend bvh".into()))
        }
        #[cfg(not(feature = "embree"))]
        Backend::Auto => Ok(Box::new(Bvh::new(geometry)?)),
        Backend::Bvh => Ok(Box::new(Bvh::new(geometry)?)),
        Backend::Brute => {
            geometry.check()?;
            Ok(Box::new(Brute::new(geometry)))
        }
    }
}
