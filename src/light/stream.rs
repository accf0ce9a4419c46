//! Direct irradiance of many receivers by few lamps, several samples to an instruction.
//!
//! The estimate is that of [`irradiance`]: the exact light of a lamp times the share of it that shadow rays find. What
//! differs: numbers are f32, every lamp gets all samples, and receivers that a lamp is close to, or whose horizon cuts it,
//! are left to [`irradiance`].

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::{
    DirectResult, LightSet, Spared, form, irradiance,
    lamp::{Lamp, Shape},
    lanes::{self, Flat, Lanes, Small},
    numbers::Numbers,
};
use crate::{sampling, scene::SurfacePoint, trace::RayTracer};

/// Lamps that are looked at one by one; where there are more, samples must be shared out.
const MOST_LAMPS: usize = 8;
/// Samples that are computed and traced together, about.
const BATCH: usize = 2048;

/// Direct irradiance of receivers, W/m2, as [`irradiance`] defines it; several times as fast for a few polygons, points,
/// spots and suns. All else is passed on. Points that are not finite, or have no unit normal, get nothing.
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
                rays += scratch.light(lamp, lights.lamps[id].colour, tracer, [per, numbers.len()], out);
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
    /// With its radius.
    Flat(Flat, f32),
    Small(Small),
    Sun(Vec3),
}

impl Kind {
    fn of(lamp: &Lamp) -> Option<Kind> {
        match &lamp.shape {
            Shape::Polygon(p) => {
                let [corner, next, .., last] = p.corners;
                let (edge_u, edge_v) = (next - corner, last - corner);
                let node = |&(s, t, share): &(f64, f64, f64)| {
                    (corner + s as f32 * edge_u + t as f32 * edge_v, share as f32 * p.area)
                };
                let flat = Flat {
                    corners: p.corners,
                    edge_u,
                    edge_v,
                    fold: if p.count == 4 { 0.0 } else { 0.5 },
                    normal: p.normal,
                    area: p.area,
                    centre: p.corners[..p.count].iter().sum::<Vec3>() / p.count as f32,
                    both_sides: p.both_sides,
                    nodes: form::nodes(p.count).iter().map(node).collect(),
                };
                Some(Kind::Flat(flat, p.radius))
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
    occluded: Vec<bool>,
    /// Receivers whose rays are cast, and what the lamp gives each in full view, by unit colour.
    cast: Vec<(usize, f32)>,
    /// Receivers that are left to the general method.
    left: Vec<usize>,
}

impl Scratch {
    /// Takes the samples of the receivers.
    fn fill(&mut self, points: &[SurfacePoint], per: usize, numbers: &Numbers, lamp: u64) {
        let n = numbers.len();
        let l = &mut self.lanes;
        l.resize(points.len() / per * n);
        for (receiver, begin) in points.chunks_exact(per).zip((0..).step_by(n)) {
            let own = begin..begin + n;
            for (i, k) in own.clone().zip((0..per).cycle()) {
                let SurfacePoint { position, normal } = receiver[k];
                (l.px[i], l.py[i], l.pz[i]) = (position.x, position.y, position.z);
                (l.nx[i], l.ny[i], l.nz[i]) = (normal.x, normal.y, normal.z);
            }
            let shift = sampling::hash(&[numbers.identity(&receiver[0]), lamp]);
            numbers.shift_all(shift, &mut l.u[own.clone()], &mut l.v[own]);
        }
    }

    /// Adds the light of one lamp, of this colour, to the receivers; the rays that it took.
    fn light(
        &mut self,
        lamp: &Kind,
        colour: Vec3,
        tracer: &dyn RayTracer,
        [per, samples]: [usize; 2],
        out: &mut [Vec3],
    ) -> u64 {
        match lamp {
            Kind::Flat(flat, _) => lanes::flat(&mut self.lanes, flat),
            Kind::Small(small) => lanes::small(&mut self.lanes, small),
            Kind::Sun(direction) => lanes::sun(&mut self.lanes, *direction),
        }
        self.cast.clear();
        self.left.clear();
        for r in 0..out.len() {
            let own = r * samples..(r + 1) * samples;
            let lit = self.lanes.weight[own.clone()].iter().filter(|&&w| w > 0.0).count();
            // The samples of a single point all see the whole lamp alike.
            let one = if per == 1 { own.start..own.start + 1 } else { own.clone() };
            if let Kind::Flat(flat, radius) = lamp {
                match self.view(*radius, lit, own.clone()) {
                    Light::None => continue,
                    Light::Hard => {
                        self.left.push(r);
                        continue;
                    }
                    Light::Far => lanes::quadrature(&mut self.lanes, flat, one.clone()),
                    Light::Near => lanes::outline(&mut self.lanes, flat, one.clone()),
                }
            } else if lit == 0 {
                continue;
            }
            let open = self.lanes.open[one.clone()].iter().sum::<f32>() / one.len() as f32;
            // Rays and weights move up to the place of those that are not cast.
            let to = self.cast.len() * samples;
            if to != own.start {
                self.lanes.rays.copy_within(own.clone(), to);
                self.lanes.weight.copy_within(own, to);
            }
            self.cast.push((r, open));
        }
        let n = self.cast.len() * samples;
        self.lanes.rays.resize(n);
        self.lanes.rays.coherent = true;
        self.occluded.clear();
        self.occluded.resize(n, false);
        tracer.occluded(&self.lanes.rays, &mut self.occluded);
        for (&(r, open), begin) in self.cast.iter().zip((0..).step_by(samples)) {
            let own = begin..begin + samples;
            let (mut all, mut arrived) = (0.0, 0.0);
            for (weight, &occluded) in self.lanes.weight[own.clone()].iter().zip(&self.occluded[own]) {
                all += weight;
                arrived += if occluded { 0.0 } else { *weight };
            }
            if arrived > 0.0 {
                out[r] = (out[r] + (colour * open * (arrived / all)).min(Vec3::MAX)).min(Vec3::MAX);
            }
        }
        n as u64
    }

    /// How a polygon stands to the receiver of some samples, of which `lit` get light from their places on it.
    fn view(&self, radius: f32, lit: usize, own: Range<usize>) -> Light {
        let l = &self.lanes;
        let least = |values: &[f32]| values.iter().copied().fold(f32::INFINITY, f32::min);
        if l.high[own.clone()].iter().all(|&h| h <= 0.0) {
            return Light::None;
        }
        let (away, cut) = (least(&l.away[own.clone()]).sqrt() / radius, least(&l.low[own.clone()]) < 0.0);
        let few = lit < LEAST.min(own.len());
        match () {
            _ if lit == 0 && !cut => Light::None,
            _ if away < CLOSE || cut && (few || away > TINY) => Light::Hard,
            _ if away > form::FAR as f32 && !cut => Light::Far,
            _ => Light::Near,
        }
    }
}

/// How the light of a polygon is computed.
enum Light {
    /// There is none.
    None,
    /// By quadrature.
    Far,
    /// By Lambert's formula.
    Near,
    /// By the general method.
    Hard,
}

/// A polygon whose distance is below so many of its radii is close: its parts differ too much in what they give.
const CLOSE: f32 = 1.3;
/// From so many radii on, contour integrals lose their digits in f32.
const TINY: f32 = 30.0;
/// Samples that must see the part of a polygon above the horizon.
const LEAST: usize = 6;

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

    const SEED: u64 = 5;
    /// Points from which the general method first looks at a lamp.
    const ASKED: usize = 4;

    /// Patches of 16 points.
    fn patches(count: u64) -> Vec<SurfacePoint> {
        let patch = |i: u64| {
            let (corner, normal) = (place(i, 0), place(i, 3).normalize());
            let (t, b) = sampling::frame(normal);
            (0..16).map(move |k| {
                let [u, v, ..] = sampling::sobol4(k, SEED);
                SurfacePoint { position: corner + 0.05 * (u * t + v * b), normal }
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
    fn in_full_view_lanes_give_the_exact_light() {
        let (points, tracer) = (patches(400), Brute::new(&Geometry::default()));
        for light in lights() {
            let set = LightSet::of_light(&light);
            let Some(lamp) = set.lamps.first().filter(|lamp| Kind::of(lamp).is_some()) else { continue };
            for per in [16, 1] {
                let exact = |own: &[SurfacePoint]| own.iter().map(|x| lamp.unshadowed(x)).sum::<f64>() / per as f64;
                let expected: Vec<Vec3> = points.chunks(per).map(|own| exact(own) as f32 * lamp.colour).collect();
                let got = irradiance_of_few(&set, &tracer, &points, per, 16, SEED).irradiance;
                let most = expected.iter().map(|e| e.max_element()).fold(0.0, f32::max);
                assert!(expected.iter().filter(|e| **e != Vec3::ZERO).count() > expected.len() / 8, "{light:?}");
                let mut sampled = (0.0, 0.0);
                for (i, own) in points.chunks(per).enumerate() {
                    let off = (got[i] - expected[i]).y as f64;
                    if own.len() > ASKED && exact(&own[..ASKED]) == 0.0 {
                        // Where its plane or horizon cuts the lamp, such a patch is left to the general method, which then
                        // looks from a quarter of the points only: right in the mean.
                        sampled = (sampled.0 + off, sampled.1 + off * off);
                    } else {
                        // Terms of the outline cancel: a lamp seen under an angle a is told to 1e-6 / a.
                        assert!(
                            off.abs() <= (1e-4 * expected[i].y + 1e-6 * most) as f64,
                            "{light:?}, {per}, {i}: {off}"
                        );
                    }
                }
                assert!(sampled.0.abs() <= 4.0 * sampled.1.sqrt(), "{light:?}, {per}: {sampled:?}");
            }
        }
    }

    #[test]
    fn shadows_are_those_of_the_general_method() {
        let (points, tracer) = (patches(400), obstacles());
        for light in lights() {
            let set = LightSet::of_light(&light);
            for per in [16, 1] {
                let expected = irradiance(&set, &tracer, &points, per, 16, SEED).irradiance;
                let got = irradiance_of_few(&set, &tracer, &points, per, 16, SEED).irradiance;
                let most = expected.iter().map(|e| e.max_element()).fold(0.0, f32::max);
                let (mut same, mut sampled) = (0, (0.0, 0.0));
                for (i, own) in points.chunks(per).enumerate() {
                    let off = (got[i] - expected[i]).y as f64;
                    // Patches whose first points get nothing are given fewer samples by the general method.
                    let asked = |x: &SurfacePoint| set.lamps.iter().any(|lamp| lamp.unshadowed(x) > 0.0);
                    let asked = set.lamps.is_empty() || own.iter().take(ASKED).any(asked);
                    if asked && own.iter().all(|x| is_whole(&set, x)) {
                        // Both cast the same rays, and rounding turns none of these 6400; the light in full view is rounded
                        // as above.
                        assert!(
                            off.abs() <= (1e-4 * expected[i].y + 1e-6 * most) as f64,
                            "{light:?}, {per}, {i}: {off}"
                        );
                        same += 1;
                    } else {
                        // By area here, by solid angle there: two estimates of one light, independent between receivers.
                        sampled = (sampled.0 + off, sampled.1 + off * off);
                    }
                }
                assert!(same > points.len() / per / 16, "{light:?}, {per}: {same}");
                assert!(sampled.0.abs() <= 4.0 * sampled.1.sqrt(), "{light:?}, {per}: {sampled:?}");
            }
        }
    }

    /// Whether a point sees a lamp whole, or nothing of it: neither its horizon nor the lamp's plane cuts it.
    fn is_whole(set: &LightSet, x: &SurfacePoint) -> bool {
        set.lamps.iter().filter_map(Lamp::polygon).all(|p| {
            let above = p.corners.iter().all(|c| x.normal.dot(*c - x.position) > 1e-6);
            above && p.normal.dot(x.position - p.corners[0]) > 1e-6
        })
    }

    #[test]
    fn several_lamps_add_up_and_unsound_receivers_stay_dark() {
        let (mut points, tracer) = (patches(64), obstacles());
        points[..16].iter_mut().for_each(|x| x.position = Vec3::NAN);
        points[16..32].iter_mut().for_each(|x| x.normal *= 2.0);
        let lights: Vec<LightSet> = lights()[3..6].iter().map(LightSet::of_light).collect();
        let all = irradiance_of_few(&LightSet::union(lights.iter()), &tracer, &points, 16, 16, SEED);
        let each: Vec<DirectResult> =
            lights.iter().map(|l| irradiance_of_few(l, &tracer, &points, 16, 16, SEED)).collect();
        for (i, sum) in all.irradiance.iter().enumerate() {
            // Points like these have one place: every sample's ray is the same, whatever its numbers.
            let expected: Vec3 = each.iter().map(|e| e.irradiance[i]).sum();
            assert!((*sum - expected).abs().max_element() <= 1e-6 * expected.max_element(), "{i}: {sum} {expected}");
        }
        assert_eq!([all.irradiance[0], all.irradiance[1]], [Vec3::ZERO; 2]);
        assert!(all.irradiance.iter().any(|e| *e != Vec3::ZERO));
    }
}
