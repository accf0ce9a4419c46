//! Ray queries by Embree, through the C shim in `ffi/`.
//!
//! What the shim relies on and this file ensures: all arrays of a batch have the same length, results have room for
//! as many, indices are in range, and a scene can only be traced once it was committed (there is no other
//! [`Embree`]). What the shim ensures by itself: aligned packets, masks on tails, preset ids, restored
//! floating-point mode.
#![allow(unsafe_code)]

use std::ffi::CStr;
use std::ptr::NonNull;

use super::{Geometry, Hit, RayBatch, RayTracer};
use crate::{Error, Result};

#[allow(non_camel_case_types, dead_code, missing_docs)]
mod ffi {
    include!(concat!(env!("CARGO_MANIFEST_DIR"), "/ffi/embree_bindings.rs"));
}

/// Up to so many triangles sorted rays are traced as one packet; beyond it packets spread over too many nodes.
///
/// Measured on closed boxes, cosine-distributed Morton-sorted rays, packets against single rays, Mrays/s:
/// 36 triangles 39.6 / 17.6, 324: 14.8 / 10.4, 900: 11.4 / 9.9, 3600: 7.8 / 8.6, 32400: 4.7 / 5.6.
const COHERENT_CLOSEST: usize = 1500;

/// The same for occlusion: 36 triangles 66 / 44, 144: 33 / 27, 324: 20.4 / 20.7, 900: 15.7 / 18.5.
const COHERENT_OCCLUDED: usize = 300;

/// A committed Embree scene.
pub struct Embree {
    handle: NonNull<ffi::LuxelEmbree>,
    version: (u32, u32, u32),
    native_width: u32,
    width: u32,
    triangles: usize,
}

// SAFETY: the handle is not bound to a thread: Embree allows any thread to release a scene and its device.
unsafe impl Send for Embree {}
// SAFETY: every query takes a committed scene, which Embree promises to leave unchanged and to trace from any number
// of threads at once; the shim keeps no state between calls.
unsafe impl Sync for Embree {}

impl Embree {
    /// Builds a scene that traces the widest packets which this processor runs as such: packets were never slower
    /// than single rays in any measured scene, while wider ones than native gain nothing.
    ///
    /// # Errors
    /// [`Error::Backend`] if the geometry is invalid or Embree refuses (out of memory, unknown processor).
    pub fn new(geometry: &Geometry) -> Result<Embree> {
        geometry.check()?;
        let mut handle = std::ptr::null_mut();
        // SAFETY: both arrays are passed with their own lengths; Vec3 and [u32; 3] are three packed 4-byte values,
        // as their Pod implementations guarantee; `check` found every index in range. The shim copies.
        let code = unsafe {
            ffi::luxel_embree_new(
                bytemuck::cast_slice::<_, f32>(&geometry.positions).as_ptr(),
                geometry.positions.len(),
                bytemuck::cast_slice::<_, u32>(&geometry.triangles).as_ptr(),
                geometry.triangles.len(),
                &mut handle,
            )
        };
        let handle = NonNull::new(handle).filter(|_| code == 0).ok_or_else(|| {
            // SAFETY: the text is a string literal of the shim.
            let text = unsafe { CStr::from_ptr(ffi::luxel_embree_error_text(code)) };
            Error::Backend(format!("embree: {}; --backend bvh does without it", text.to_string_lossy()))
        })?;
        let mut info = ffi::LuxelEmbreeInfo { major: 0, minor: 0, patch: 0, native_width: 1 };
        // SAFETY: the handle was just made and `info` is writable.
        unsafe { ffi::luxel_embree_info(handle.as_ptr(), &mut info) };
        Ok(Embree {
            handle,
            version: (info.major, info.minor, info.patch),
            native_width: info.native_width,
            width: info.native_width,
            triangles: geometry.triangles.len(),
        })
    }

    /// The same scene traced in packets of another width: 1, 4, 8 or 16, for comparisons.
    ///
    /// # Errors
    /// [`Error::Option`] for any other width.
    pub fn with_width(mut self, width: u32) -> Result<Embree> {
        if ![1, 4, 8, 16].contains(&width) {
            return Err(Error::Option(format!("packets of {width} rays do not exist: use 1, 4, 8 or 16")));
        }
        self.width = width;
        Ok(self)
    }

    /// Rays a packet.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Traces one packet of `width` rays with guard bytes around its structs; whether they are untouched.
    pub fn guards_survive(&self, width: u32) -> bool {
        // SAFETY: the scene is committed; the packets live inside the call.
        unsafe { ffi::luxel_embree_guards_survive(self.handle.as_ptr(), width) }
    }

    /// What the bare library takes, for benches: traces the whole packets of `rays`, whose directions are unit vectors
    /// and whose limits are not looked at, and tells the ids of the triangles met, added up (modulo 2^32).
    pub fn bare(&self, rays: &RayBatch) -> u32 {
        let view = Self::view(rays, rays.len(), rays.coherent && self.traces_packets());
        // SAFETY: `view` checked that every array has `count` elements.
        unsafe { ffi::luxel_embree_bare(self.handle.as_ptr(), &view, self.width) }
    }

    /// The batch as the shim sees it, borrowed for the call.
    fn view(rays: &RayBatch, results: usize, coherent: bool) -> ffi::LuxelRays {
        let n = rays.len();
        let lengths = [
            rays.origin_y.len(),
            rays.origin_z.len(),
            rays.direction_x.len(),
            rays.direction_y.len(),
            rays.direction_z.len(),
            rays.t_min.len(),
            rays.t_max.len(),
            results,
        ];
        assert!(lengths.iter().all(|&l| l == n), "the arrays of a batch and its results must have one length");
        ffi::LuxelRays {
            origin_x: rays.origin_x.as_ptr(),
            origin_y: rays.origin_y.as_ptr(),
            origin_z: rays.origin_z.as_ptr(),
            direction_x: rays.direction_x.as_ptr(),
            direction_y: rays.direction_y.as_ptr(),
            direction_z: rays.direction_z.as_ptr(),
            t_min: rays.t_min.as_ptr(),
            t_max: rays.t_max.as_ptr(),
            count: n,
            coherent,
        }
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: the handle came from luxel_embree_new and is freed only here.
        unsafe { ffi::luxel_embree_free(self.handle.as_ptr()) }
    }
}

impl RayTracer for Embree {
    fn name(&self) -> String {
        let (major, minor, patch) = self.version;
        format!("embree {major}.{minor}.{patch}, {}-wide", self.width)
    }

    fn instruction_set(&self) -> String {
        match self.native_width {
            16 => "AVX-512",
            8 if has_avx2() => "AVX2",
            8 => "AVX",
            _ if cfg!(target_arch = "aarch64") => "NEON",
            _ => "SSE",
        }
        .into()
    }

    fn traces_packets(&self) -> bool {
        self.triangles <= COHERENT_CLOSEST
    }

    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]) {
        let view = Self::view(rays, hits.len(), rays.coherent && self.traces_packets());
        // SAFETY: `view` checked that every array and `hits` have `count` elements; Hit is repr(C) with the fields
        // of LuxelHit, which a test compares with C's own layout.
        unsafe { ffi::luxel_embree_closest_hits(self.handle.as_ptr(), &view, self.width, hits.as_mut_ptr().cast()) }
    }

    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]) {
        let view = Self::view(rays, occluded.len(), rays.coherent && self.triangles <= COHERENT_OCCLUDED);
        // SAFETY: as above; the shim writes only 0 and 1, which are the bytes of a bool.
        unsafe { ffi::luxel_embree_occluded(self.handle.as_ptr(), &view, self.width, occluded.as_mut_ptr().cast()) }
    }
}

fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

#[cfg(test)]
mod tests {
    use std::mem::{align_of, offset_of, size_of};

    use glam::Vec3;

    use super::*;

    fn one_triangle() -> Geometry {
        Geometry {
            positions: vec![Vec3::new(1.0, -1.0, -1.0), Vec3::new(1.0, 1.0, -1.0), Vec3::new(1.0, 0.0, 2.0)],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn structs_have_the_layout_that_c_says_they_have() {
        let mut c = ffi::LuxelEmbreeLayout {
            rays_size: 0,
            rays_count_offset: 0,
            rays_coherent_offset: 0,
            hit_size: 0,
            hit_face_offset: 0,
            info_size: 0,
        };
        // SAFETY: `c` is writable.
        unsafe { ffi::luxel_embree_layout(&mut c) };
        assert_eq!(c.rays_size, size_of::<ffi::LuxelRays>());
        assert_eq!(c.rays_count_offset, offset_of!(ffi::LuxelRays, count));
        assert_eq!(c.rays_coherent_offset, offset_of!(ffi::LuxelRays, coherent));
        assert_eq!(c.hit_size, size_of::<Hit>());
        assert_eq!(c.hit_face_offset, offset_of!(Hit, face));
        assert_eq!(align_of::<Hit>(), align_of::<ffi::LuxelHit>());
        assert_eq!(offset_of!(Hit, t), offset_of!(ffi::LuxelHit, t));
        assert_eq!(offset_of!(Hit, u), offset_of!(ffi::LuxelHit, u));
        assert_eq!(offset_of!(Hit, v), offset_of!(ffi::LuxelHit, v));
        assert_eq!(c.info_size, size_of::<ffi::LuxelEmbreeInfo>());
    }

    #[test]
    fn embree_writes_nothing_outside_its_ray_and_hit_structs() {
        let tracer = Embree::new(&one_triangle()).unwrap();
        for width in [1, 4, 8, 16] {
            assert!(tracer.guards_survive(width), "width {width}");
        }
    }

    #[test]
    fn results_behind_the_last_ray_are_left_alone() {
        let mark = Hit { t: 7.0, u: 7.0, v: 7.0, face: 7 };
        for width in [1, 4, 8, 16] {
            let tracer = Embree::new(&one_triangle()).unwrap().with_width(width).unwrap();
            for n in 0..=33 {
                let mut rays = RayBatch::default();
                (0..n).for_each(|_| rays.push(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY));
                let mut hits = vec![mark; n + 16];
                tracer.closest_hits(&rays, &mut hits[8..8 + n]);
                assert!(hits[..8].iter().chain(&hits[8 + n..]).all(|h| *h == mark), "width {width}, {n} rays");
                assert!(hits[8..8 + n].iter().all(|h| h.t == 1.0 && h.face == 1), "width {width}, {n} rays");
                let mut occluded = vec![false; n + 16];
                tracer.occluded(&rays, &mut occluded[8..8 + n]);
                assert!(!occluded[..8].iter().chain(&occluded[8 + n..]).any(|&o| o), "width {width}, {n} rays");
                assert!(occluded[8..8 + n].iter().all(|&o| o), "width {width}, {n} rays");
            }
        }
    }

    #[test]
    fn the_floating_point_mode_of_the_caller_is_restored() {
        let tracer = Embree::new(&one_triangle()).unwrap();
        let mut rays = RayBatch::default();
        rays.push(Vec3::ZERO, Vec3::X, 0.0, 10.0);
        tracer.closest_hits(&rays, &mut [Hit::NONE]);
        tracer.occluded(&rays, &mut [false]);
        // SAFETY: reads a register.
        assert!(!unsafe { ffi::luxel_embree_flushes_denormals() });
        assert!(std::hint::black_box(f32::MIN_POSITIVE) / 2.0 > 0.0);
    }

    #[test]
    fn a_width_that_does_not_exist_is_refused() {
        assert!(Embree::new(&one_triangle()).unwrap().with_width(3).is_err());
    }
}
