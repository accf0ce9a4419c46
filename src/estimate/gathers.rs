//! Vertices held against rays of their own.
//!
//! Rays from the very place of a vertex see what patches around it are too large for. Two gathers of independent rays are
//! held against the light of a vertex: their noise has no share in the mean of the product of the two differences, so that
//! few rays will do. What the gathers meet has one radiosity a patch; what that costs is told by meeting coarse patches too.

use glam::Vec3;

use super::{
    LookedAt, Variance,
    patches::{Field, detail_of, vec3},
};
use crate::{
    bake::Bake,
    colour::luminance,
    options::Reconstruct,
    reconstruct::{self, Senders},
    scene::SurfacePoint,
};

/// Rays of a gather that interpolated light is held against: half of those of a row, and at least so many.
const LEAST_RAYS: u32 = 16;
/// Purpose word of random bits.
const AGAIN: u64 = 0x6761_7468;

/// Replaces what `variance` says of interpolation by what gathers say: at points in doubt, or everywhere if the points of
/// the bake gather themselves. `fitted` is the luminance of the points' light as it is interpolated, `coarse` the radiosity
/// of the coarse patches for each patch of the bake.
pub(super) fn correct(
    bake: &Bake,
    field: &Field,
    coarse: &[[f64; 3]],
    looked_at: &LookedAt,
    fitted: &[f64],
    variance: &mut Variance,
) {
    let options = &bake.options;
    let everywhere = options.reconstruct.gathers();
    let asking: Vec<usize> = (0..fitted.len()).filter(|&k| everywhere || looked_at.doubt[k]).collect();
    let points: Vec<SurfacePoint> = asking.iter().map(|&k| looked_at.points[k]).collect();
    // Which points of the bake gathered.
    let gathered = match options.reconstruct {
        Reconstruct::Gather => vec![true; points.len()],
        Reconstruct::Adaptive => {
            let own = bake.field(field.received, field.sent);
            reconstruct::in_doubt(&reconstruct::Field { stencils: Some(&looked_at.stencils), ..own }, &points)
        }
        Reconstruct::Smooth | Reconstruct::Nearest4 => vec![false; points.len()],
    };
    let rays = if everywhere { options.gather_rays } else { (options.rays / 2).clamp(LEAST_RAYS, options.gather_rays) };
    // Both radiosities by one ray: luminance is all that is asked for.
    let pairs = |a: &dyn Fn(usize) -> f64, b: &dyn Fn(usize) -> f64| {
        (0..coarse.len()).map(|i| vec3([a(i), b(i), 0.0])).collect::<Vec<Vec3>>()
    };
    let received = |i: usize| luminance(field.received[i]);
    let (received, sent) =
        (pairs(&received, &received), pairs(&|i| luminance(field.sent[i]), &|i| luminance(vec3(coarse[i]))));
    let gather = |seed: u64| {
        let own = bake.field(&received, &sent);
        let senders = own.senders.map(|senders| Senders { rays, seed, ..senders });
        reconstruct::interpolate(&reconstruct::Field { senders, ..own }, Reconstruct::Gather, &points)
    };
    let (one, other) = (gather(options.seed), gather(options.seed ^ AGAIN));
    for (((&k, gathered), one), other) in asking.iter().zip(gathered).zip(&one).zip(&other) {
        let detail = detail_of((one.y - one.x) as f64 * (other.y - other.x) as f64);
        if gathered {
            variance.rows[k] = 0.5 * ((one.x - other.x) as f64).powi(2);
            variance.detail[k] = detail;
        } else {
            let off = |e: &Vec3| fitted[k] - e.x as f64;
            // The noise of the rows is in both differences, and is told apart.
            variance.detail[k] = off(one) * off(other) - variance.rows[k] + detail;
        }
    }
}
