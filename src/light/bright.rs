//! Small bright patches as lamps.

use glam::Vec3;

use super::LightSet;
use crate::simplify::{Simplified, clip::point_at};

/// A patch is bright from this many times the mean first reflection on.
const BRIGHT: f64 = 12.0;
/// Share of the second moment of the first reflection from which bright patches are worth it.
const WORTH: f64 = 0.5;
/// Most bright patches.
const MOST: usize = 4096;

/// The patches whose first reflection few rays would find, but that light the scene much: a wall close to a lamp, the
/// spot of a spot light. Their first reflection is sent out as that of lamps, aimed at by shadow rays.
pub struct Bright {
    /// The patches, in order.
    pub patches: Vec<u32>,
    /// Their pieces of surface as lamps.
    pub lights: LightSet,
}

impl Bright {
    /// Chooses the bright patches by the first reflection of all (`source`, W/m2) among those that light reaches;
    /// none where they would not matter.
    ///
    /// The variance of a row's irradiance goes with the mean of the square of what its rays meet: bright patches are
    /// taken out if they make up more than half of it.
    pub fn choose(simplified: &Simplified, source: &[[f64; 3]], reached: &[bool]) -> Option<Bright> {
        let patches = Bright::patches(simplified, source, reached)?;
        let radiance = |i: u32| Vec3::from_array(source[i as usize].map(|s| (s / std::f64::consts::PI) as f32));
        let lights = Bright::lights(simplified, &patches, radiance);
        Some(Bright { patches, lights })
    }

    /// The patches that [`Bright::choose`] chooses.
    pub(crate) fn patches(simplified: &Simplified, source: &[[f64; 3]], reached: &[bool]) -> Option<Vec<u32>> {
        let patches = &simplified.patches;
        let strength = |i: usize| source[i].iter().sum::<f64>() / 3.0;
        let area = |i: usize| patches.area[i] as f64;
        let all = || (0..patches.len()).filter(|&i| reached[i]);
        let seen: f64 = all().map(area).sum();
        let mean = all().map(|i| area(i) * strength(i)).sum::<f64>() / seen;
        let mut chosen: Vec<u32> = all().filter(|&i| strength(i) > BRIGHT * mean).map(|i| i as u32).collect();
        if chosen.len() > MOST {
            chosen.sort_by(|&a, &b| strength(b as usize).total_cmp(&strength(a as usize)).then(a.cmp(&b)));
            chosen.truncate(MOST);
            chosen.sort_unstable();
        }
        let square = |i: usize| area(i) * strength(i).powi(2);
        let theirs: f64 = chosen.iter().map(|&i| square(i as usize)).sum();
        if theirs <= WORTH * all().map(square).sum::<f64>() {
            return None;
        }
        Some(chosen)
    }

    /// The surfaces of `patches` as lamps, with the radiance of each (W/m2/sr).
    pub(crate) fn lights(simplified: &Simplified, patches: &[u32], radiance: impl Fn(u32) -> Vec3) -> LightSet {
        let mut polygons: Vec<(Vec<Vec3>, Vec3)> = Vec::new();
        for &i in patches {
            polygons.extend(outlines(simplified, i).into_iter().map(|outline| (outline, radiance(i))));
        }
        LightSet::of_polygons(polygons.iter().map(|(corners, radiance)| (&corners[..], *radiance)))
    }
}

/// The surface of a patch as triangles and parallelograms, counter-clockwise as seen from the side that it shows.
pub(super) fn outlines(simplified: &Simplified, patch: u32) -> Vec<Vec<Vec3>> {
    let mut polygons = Vec::new();
    for &member in simplified.patches.members(patch as usize) {
        let f = (member >> 1) as usize;
        let corners = simplified.corners(simplified.fragments.triangle[f] as usize);
        let mut outline: Vec<Vec3> = simplified.fragments.uv(f).iter().map(|&uv| point_at(&corners, uv)).collect();
        if member & 1 == 1 {
            outline.reverse();
        }
        if is_parallelogram(&outline) {
            polygons.push(outline);
        } else {
            polygons.extend(outline[1..].windows(2).map(|w| vec![outline[0], w[0], w[1]]));
        }
    }
    polygons
}

fn is_parallelogram(outline: &[Vec3]) -> bool {
    let [a, b, c, d] = outline else { return false };
    (*a + *c - *b - *d).length() < 1e-4 * a.distance(*c)
}
