//! Direct irradiance of many receivers by few lamps, several samples to an instruction.
//!
//! The estimate is that of [`irradiance`]: the exact light of a lamp times the share of it that shadow rays find. What
//! differs: numbers are f32, every lamp gets all samples, and receivers that a lamp is close to, or whose horizon cuts it,
//! are left to [`irradiance`].

use glam::Vec3;
use rayon::prelude::*;

use super::{
    DirectResult, LightSet, Spared, irradiance,
    lanes::{self, Flat, Lanes, Small},
    lamp::{Lamp, Shape},
    numbers::Numbers,
};
use crate::{
    sampling,
    scene::{RAY_OFFSET, SurfacePoint},
    trace::{RayBatch, RayTracer},
};

/// Lamps that are looked at one by one; where there are more, samples must be shared out.
const MOST_LAMPS: usize = 8;
/// Samples that are computed and traced together, about.
const BATCH: usize = 2048;

/// Direct irradiance of receivers, W/m2, as [`irradiance`] defines it; several times as fast for a few polygons, points,
/// spots and suns. All else is passed on.
///
/// # Accuracy
/// As of [`irradiance`], with a relative rounding error of about 1e-5.
pub(crate) fn irradiance_of_few(
    lights: &LightSet,
    tracer: &dyn RayTracer,
    points: &[SurfacePoint],
    points_per_receiver: usize,
    samples: u32,
    seed: u64,
) -> DirectResult {
    let lamps: Option<Vec<Kind>> = lights.lamps.iter().map(Kind::of).collect();
    let per = points_per_receiver.max(1);
    let lamps = match lamps {
        Some(lamps) if lamps.len() <= MOST_LAMPS && !lights.has_sky() => lamps,
        _ => return irradiance(lights, tracer, points, per, samples, seed),
    };
    let numbers = Numbers::new(samples, per, seed);
    let chunk = (BATCH / samples as usize).max(1);
    let mut found = vec![Vec3::ZERO; points.len() / per];
    let rays = found
        .par_chunks_mut(chunk)
        .zip(points.par_chunks(chunk * per))
        .map_init(Scratch::default, |scratch, (out, points)| {
            let mut rays = 0;
            for (id, lamp) in lamps.iter().enumerate() {
                scratch.fill(points, per, &numbers, id as u64);
                rays += scratch.light(lamp, lights.lamps[id].colour, tracer, numbers.len(), out);
                if !scratch.left.is_empty() {
                    let one = LightSet::of(vec![lights.lamps[id].clone()], Default::default());
                    let own: Vec<SurfacePoint> =
                        scratch.left.iter().flat_map(|&r| &points[r * per..(r + 1) * per]).copied().collect();
                    let result = irradiance(&one, tracer, &own, per, samples, seed);
                    rays += result.rays;
                    for (&r, e) in scratch.left.iter().zip(result.irradiance) {
                        out[r] = (out[r] + e).min(Vec3::MAX);
                    }
                }
            }
            rays
        })
        .sum();
    DirectResult { irradiance: found, rays, spared: Spared::default() }
}

/// A lamp as the lanes know it.
enum Kind {
    Flat(Flat),
    Small(Small),
    Sun(Vec3),
}

impl Kind {
    fn of(lamp: &Lamp) -> Option<Kind> {
        match &lamp.shape {
            Shape::Polygon(p) => {
                let [corner, next, .., last] = p.corners;
                let centre = p.corners[..p.count].iter().sum::<Vec3>() / p.count as f32;
                Some(Kind::Flat(Flat {
                    corners: p.corners,
                    edge_u: next - corner,
                    edge_v: last - corner,
                    fold: if p.count == 4 { 0.0 } else { 0.5 },
                    normal: p.normal,
                    area: p.area,
                    centre,
                    radius: p.radius,
                    both_sides: p.both_sides,
                }))
            }
            Shape::Point { position, range } => Some(Kind::Small(Small::point(*position, *range))),
            Shape::Spot { position, direction, cos_inner, cos_outer, range } => Some(Kind::Small(Small {
                direction: *direction,
                cos_inner: *cos_inner,
                cos_outer: *cos_outer,
                ..Small::point(*position, *range)
            })),
            Shape::Sun { direction } => Some(Kind::Sun(*direction)),
            Shape::Disc { .. } => None,
        }
    }
}

/// Memory of a thread.
#[derive(Default)]
struct Scratch {
    lanes: Lanes,
    rays: RayBatch,
    weights: Vec<f32>,
    occluded: Vec<bool>,
    /// Of each receiver, one past its last ray, the light of the lamp in full view, and the sum of its weights.
    groups: Vec<Group>,
    /// Receivers that are left to the general method.
    left: Vec<usize>,
}

struct Group {
    end: usize,
    /// Irradiance without occluders by unit colour.
    open: f32,
}

impl Scratch {
    /// Takes the samples of the receivers.
    fn fill(&mut self, points: &[SurfacePoint], per: usize, numbers: &Numbers, lamp: u64) {
        self.lanes.clear();
        for receiver in points.chunks_exact(per) {
            let shift = sampling::hash(&[numbers.identity(&receiver[0]), lamp]);
            let sound = receiver.iter().all(SurfacePoint::is_sound);
            for k in 0..numbers.len() {
                let x = if sound { receiver[k % per] } else { SurfacePoint { position: Vec3::ZERO, normal: Vec3::ZERO } };
                let [u, v, _] = numbers.shifted(k, shift);
                self.lanes.push(&x, u, v);
            }
        }
    }

    /// Adds the light of one lamp, of this colour, to the receivers; the rays that it took.
    fn light(&mut self, lamp: &Kind, colour: Vec3, tracer: &dyn RayTracer, samples: usize, out: &mut [Vec3]) -> u64 {
        match lamp {
            Kind::Flat(flat) => lanes::flat(&mut self.lanes, flat),
            Kind::Small(small) => lanes::small(&mut self.lanes, small),
            Kind::Sun(direction) => lanes::sun(&mut self.lanes, *direction),
        }
        let t_max = if matches!(lamp, Kind::Sun(_)) { f32::INFINITY } else { 1.0 };
        self.rays.clear();
        self.rays.coherent = true;
        self.weights.clear();
        self.groups.clear();
        self.left.clear();
        let l = &self.lanes;
        for r in 0..out.len() {
            let own = r * samples..(r + 1) * samples;
            let mut open = 0.0;
            if l.hard[own.clone()].iter().any(|&hard| hard > 0.0) {
                self.left.push(r);
            } else {
                open = l.open[own.clone()].iter().sum::<f32>() / samples as f32;
            }
            if open > 0.0 {
                for i in own.filter(|&i| l.weight[i] > 0.0) {
                    let x = SurfacePoint {
                        position: Vec3::new(l.px[i], l.py[i], l.pz[i]),
                        normal: Vec3::new(l.nx[i], l.ny[i], l.nz[i]),
                    };
                    let direction = Vec3::new(l.dx[i], l.dy[i], l.dz[i]);
                    let t_min = RAY_OFFSET * direction.length_recip();
                    self.rays.push(x.position + RAY_OFFSET * x.normal, direction, t_min, t_max);
                    self.weights.push(l.weight[i]);
                }
            }
            self.groups.push(Group { end: self.rays.len(), open });
        }
        self.occluded.clear();
        self.occluded.resize(self.rays.len(), false);
        tracer.occluded(&self.rays, &mut self.occluded);
        let mut begin = 0;
        for (out, group) in out.iter_mut().zip(&self.groups) {
            let own = begin..group.end;
            begin = group.end;
            let (mut all, mut arrived) = (0.0, 0.0);
            for (weight, &occluded) in self.weights[own.clone()].iter().zip(&self.occluded[own]) {
                all += weight;
                arrived += if occluded { 0.0 } else { *weight };
            }
            if arrived > 0.0 {
                *out = (*out + (colour * group.open * (arrived / all)).min(Vec3::MAX)).min(Vec3::MAX);
            }
        }
        self.rays.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        sampling::hash,
        scene::Light,
        trace::{Brute, Geometry},
    };

    fn unit(i: u64, k: u64) -> f32 {
        (hash(&[i, k]) >> 40) as f32 / (1 << 24) as f32
    }

    fn place(i: u64, k: u64) -> Vec3 {
        Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2)) - 0.5
    }

    /// Patches of 16 points, none of them where a lamp is.
    fn patches(count: u64) -> Vec<SurfacePoint> {
        let patch = |i: u64| {
            let (corner, normal) = (place(i, 0), place(i, 3).normalize());
            let (t, b) = sampling::frame(normal);
            (0..16).map(move |k| SurfacePoint {
                position: corner + 0.02 * ((k % 4) as f32 * t + (k / 4) as f32 * b),
                normal,
            })
        };
        (0..count).flat_map(patch).collect()
    }

    /// Some triangles that throw shadows.
    fn obstacles() -> Brute {
        let positions: Vec<Vec3> = (0..24).map(|i| place(1000 + i / 3, 0) + 0.3 * place(i, 7)).collect();
        Brute::new(&Geometry { positions, triangles: (0..8).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect() })
    }

    fn lights() -> Vec<Light> {
        let (corner, edge_u) = (Vec3::new(-0.2, 0.3, -0.1), Vec3::new(0.3, 0.1, 0.0));
        let radiance = Vec3::new(1.0, 2.0, 0.5);
        vec![
            Light::Rectangle { corner, edge_u, edge_v: Vec3::new(0.0, 0.1, 0.2), radiance },
            Light::Rectangle { corner, edge_u: 0.001 * edge_u, edge_v: Vec3::new(0.0, 0.0, 0.0005), radiance },
            Light::Disc { centre: corner, normal: Vec3::NEG_Y, radius: 0.1, radiance },
            Light::Point { position: corner, intensity: radiance, range: f32::INFINITY },
            Light::Point { position: corner, intensity: radiance, range: 0.5 },
            Light::Spot {
                position: corner,
                direction: Vec3::new(0.6, -0.8, 0.0),
                intensity: radiance,
                cos_inner: 0.9,
                cos_outer: 0.5,
                range: 2.0,
            },
            Light::Sun { direction: Vec3::new(0.36, -0.8, 0.48), irradiance: radiance },
            Light::Sky { radiance },
        ]
    }

    #[test]
    fn lanes_find_the_light_that_the_general_method_finds() {
        let (points, tracer) = (patches(400), obstacles());
        for light in lights() {
            let set = LightSet::of_light(&light);
            for (per, samples) in [(16, 16), (1, 16)] {
                let expected = irradiance(&set, &tracer, &points, per, samples, 5);
                let got = irradiance_of_few(&set, &tracer, &points, per, samples, 5);
                // The rays are the same but for rounding, which takes one in a few thousand past an edge.
                let mut lit = 0;
                let mut off = 0;
                for (a, b) in got.irradiance.iter().zip(&expected.irradiance) {
                    lit += (*b != Vec3::ZERO) as usize;
                    off += ((*a - *b).abs().max_element() > 1e-4 * b.max_element()) as usize;
                }
                assert!(lit > 50, "{light:?}: {lit}");
                assert!(off * 50 < lit, "{light:?}, {per} points: {off} of {lit} differ");
            }
        }
    }

    #[test]
    fn several_lamps_add_up_and_unsound_receivers_stay_dark() {
        let (mut points, tracer) = (patches(64), obstacles());
        points[3].position = Vec3::NAN;
        points[20].normal = 2.0 * Vec3::Y;
        let lights: Vec<LightSet> = lights()[3..6].iter().map(LightSet::of_light).collect();
        let all = irradiance_of_few(&LightSet::union(lights.iter()), &tracer, &points, 16, 16, 5);
        let each: Vec<DirectResult> =
            lights.iter().map(|l| irradiance_of_few(l, &tracer, &points, 16, 16, 5)).collect();
        for (i, sum) in all.irradiance.iter().enumerate() {
            // Points like these have one place: every sample's ray is the same, whatever its numbers.
            let expected: Vec3 = each.iter().map(|e| e.irradiance[i]).sum();
            assert!((*sum - expected).abs().max_element() <= 1e-6 * expected.max_element(), "{i}: {sum} {expected}");
        }
        assert_eq!([all.irradiance[0], all.irradiance[1]], [Vec3::ZERO; 2]);
        assert!(all.irradiance.iter().any(|e| *e != Vec3::ZERO));
    }
}
