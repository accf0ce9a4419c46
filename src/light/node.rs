//! What a group of lamps may give to a receiver: a bound by its box and its cone of normals.

use glam::{Quat, Vec3};

use super::lamp::Bounds;
use crate::scene::SurfacePoint;

/// A lamp, or all those of two nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    centre: Vec3,
    /// Half of the edges of the box.
    half: Vec3,
    radius: f32,
    axis: Vec3,
    cos_spread: f32,
    sin_spread: f32,
    strength: f32,
    pub content: Content,
}

/// What a node holds.
#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    Lamp(u32),
    /// The first of two nodes that stand side by side.
    Children(u32),
}

/// What a receiver is to the tree: a ball of points with a cone of normals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    pub centre: Vec3,
    normal: Vec3,
    pub radius: f32,
    cos_spread: f32,
    sin_spread: f32,
}

impl Ball {
    /// One point.
    pub fn point(x: &SurfacePoint) -> Ball {
        Ball { centre: x.position, normal: x.normal, radius: 0.0, cos_spread: 1.0, sin_spread: 0.0 }
    }

    /// Around all of `points` (at least one).
    pub fn around(points: &[SurfacePoint]) -> Ball {
        let n = points.len() as f32;
        let centre = points.iter().map(|x| x.position).sum::<Vec3>() / n;
        let normal = points.iter().map(|x| x.normal).sum::<Vec3>().normalize_or(points[0].normal);
        let radius = points.iter().map(|x| x.position.distance(centre)).fold(0.0, f32::max);
        let cos = points.iter().map(|x| x.normal.dot(normal)).fold(1.0, f32::min).max(-1.0);
        // A little wider than the rounding of its parts.
        let cos = if cos > 1.0 - 1e-5 { 1.0 } else { cos - 1e-5 };
        Ball { centre, normal, radius, cos_spread: cos, sin_spread: sine(cos) }
    }
}

/// The nearest lamp of a node is taken for no nearer than so many radii of the node.
const NEAREST: f32 = 0.1;

impl Node {
    /// Holds a place until its children are known.
    pub const EMPTY: Node = Node {
        centre: Vec3::ZERO,
        half: Vec3::ZERO,
        radius: 0.0,
        axis: Vec3::ZERO,
        cos_spread: 1.0,
        sin_spread: 0.0,
        strength: 0.0,
        content: Content::Lamp(0),
    };

    /// Of lamps within `b`.
    pub fn new(b: &Bounds, content: Content) -> Node {
        let (sin, cos) = b.spread.sin_cos();
        Node {
            centre: 0.5 * (b.low + b.high),
            half: 0.5 * (b.high - b.low),
            // Slightly more, so that rounding cannot leave a lamp outside.
            radius: 0.5 * (b.high - b.low).length() * 1.000_01,
            axis: b.axis,
            cos_spread: cos,
            sin_spread: sin.max(0.0),
            strength: (b.strength as f32).clamp(f32::MIN_POSITIVE, f32::MAX * 1e-6),
            content,
        }
    }

    /// About the irradiance that the node gives; zero only if it gives none.
    pub fn importance(&self, receiver: &Ball) -> f32 {
        let v = self.centre - receiver.centre;
        let radius = self.radius + receiver.radius;
        let d2 = v.length_squared();
        if d2 <= radius * radius {
            return bounded(self.strength / d2.max(0.25 * radius * radius));
        }
        let per_d = d2.sqrt().recip();
        // Half-angle of the ball around the node, seen from the receiver.
        let sin_ball = radius * per_d;
        let cos_ball = (1.0 - sin_ball * sin_ball).max(0.0).sqrt();
        let wide = |cos_spread: f32, sin_spread: f32| {
            let sin = sin_ball * cos_spread + cos_ball * sin_spread;
            // A sum of angles past pi has a negative sine: everything is within it.
            if sin < 0.0 || cos_spread <= -1.0 {
                (-1.0, 0.0)
            } else {
                (cos_ball * cos_spread - sin_ball * sin_spread, sin)
            }
        };

        let (cos_wide, sin_wide) = wide(receiver.cos_spread, receiver.sin_spread);
        let at_receiver = closer(receiver.normal.dot(v) * per_d, cos_wide, sin_wide);
        let (cos_wide, sin_wide) = wide(self.cos_spread, self.sin_spread);
        let at_light = closer(-self.axis.dot(v) * per_d, cos_wide, sin_wide);
        // A margin for rounding: the horizon itself gives no light anyway.
        if at_receiver <= -1e-5 || at_light <= -1e-5 {
            return 0.0;
        }
        bounded(self.strength * at_receiver.max(1e-3) * at_light.max(1e-3) / d2)
    }

    /// The importance that the node would have if all of it were at the end of it that is next to the receiver.
    pub fn peak(&self, receiver: &Ball, importance: f32) -> f32 {
        let d2 = self.centre.distance_squared(receiver.centre);
        let radius = self.radius + receiver.radius;
        let nearest = (self.distance(receiver.centre) - receiver.radius).max(NEAREST * self.radius);
        bounded(importance * d2.max(0.25 * radius * radius) / (nearest * nearest).max(f32::MIN_POSITIVE))
    }

    /// Distance of a place from the box.
    pub fn distance(&self, place: Vec3) -> f32 {
        ((place - self.centre).abs() - self.half).max(Vec3::ZERO).length()
    }
}

/// Not zero, which would mean that a node gives nothing, and with finite sums.
fn bounded(importance: f32) -> f32 {
    importance.clamp(f32::MIN_POSITIVE, 1e30)
}

/// Cosine of max(0, a - b), angles in 0 ..= pi given by cosines (and the sine of b).
fn closer(cos_a: f32, cos_b: f32, sin_b: f32) -> f32 {
    if cos_a >= cos_b { 1.0 } else { cos_a * cos_b + sine(cos_a) * sin_b }
}

fn sine(cos: f32) -> f32 {
    (1.0 - cos * cos).max(0.0).sqrt()
}

impl Bounds {
    /// Around both.
    pub fn union(&self, other: &Bounds) -> Bounds {
        let (axis, spread) = cone_union(self, other);
        Bounds {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            axis,
            spread,
            strength: self.strength + other.strength,
        }
    }
}

/// The smallest cone around two (Conty Estevez & Kulla 2018, algorithm 1).
fn cone_union(a: &Bounds, b: &Bounds) -> (Vec3, f32) {
    use std::f32::consts::PI;
    let (a, b) = if a.spread >= b.spread { (a, b) } else { (b, a) };
    // atan2: acos of a dot product loses half the digits of small angles.
    let between = a.axis.cross(b.axis).length().atan2(a.axis.dot(b.axis));
    if (between + b.spread).min(PI) <= a.spread {
        return (a.axis, a.spread);
    }
    let spread = 0.5 * (a.spread + between + b.spread);
    let pivot = a.axis.cross(b.axis);
    if spread >= PI || pivot.length_squared() < 1e-12 {
        // Opposite axes have no plane in common; a whole sphere always holds both. Equal axes need the wider cone.
        return if between > 1.0 || spread >= PI { (a.axis, PI) } else { (a.axis, a.spread + between) };
    }
    let axis = Quat::from_axis_angle(pivot.normalize(), spread - a.spread) * a.axis;
    (axis.normalize(), spread)
}
