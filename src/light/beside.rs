//! Receivers beside lamps.

use rayon::prelude::*;

use super::{LightSet, node::Ball};
use crate::scene::SurfacePoint;

/// How far, in radii of a receiver, a lamp beside it may be.
const REACH: f32 = 4.0;

/// Which receivers of some extent have a lamp beside them: its light varies much over them, so that few samples tell it
/// badly. Receivers are `points_per_receiver` consecutive `points`. The pieces of bright patches are not meant, which are
/// too many.
pub fn beside_lamps(lights: &LightSet, points: &[SurfacePoint], points_per_receiver: usize) -> Vec<bool> {
    points
        .par_chunks_exact(points_per_receiver.max(1))
        .map(|of_one| {
            let sound = !lights.polygons && of_one.iter().all(SurfacePoint::is_sound);
            sound && lights.tree.has_near(&Ball::around(of_one), REACH)
        })
        .collect()
}
