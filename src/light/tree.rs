//! A tree over many lamps: picks one with a probability near its share, without visiting all.
//!
//! After Conty Estevez & Kulla 2018 ("Importance sampling of many lights with adaptive tree splitting"): nodes know a
//! box, a cone of normals and a strength. The importance is zero only where no lamp of the node can give light, so
//! that picks are unbiased.

use glam::{Quat, Vec3};

use super::lamp::{Bounds, Lamp};
use crate::scene::SurfacePoint;

#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    centre: Vec3,
    /// Half of the edges of the box.
    half: Vec3,
    radius: f32,
    axis: Vec3,
    cos_spread: f32,
    sin_spread: f32,
    strength: f32,
    content: Content,
}

#[derive(Clone, Copy, Debug)]
enum Content {
    Lamp(u32),
    /// The first of two nodes that stand side by side.
    Children(u32),
}

/// What a receiver is to the tree: a ball of points with a cone of normals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    centre: Vec3,
    normal: Vec3,
    radius: f32,
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

/// A part of the tree, with its importance to a receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Branch {
    node: u32,
    pub importance: f32,
    /// What it gives if all of it is as near as its nearest lamp may be; known in a cut.
    peak: f32,
}

/// The nearest lamp of a node is taken for no nearer than so many radii of the node.
const NEAREST: f32 = 0.1;

impl Tree {
    /// Over the lamps that have bounds.
    pub fn new(lamps: &[Lamp]) -> Tree {
        let mut items: Vec<(u32, Bounds)> =
            lamps.iter().enumerate().filter_map(|(i, l)| Some((i as u32, l.bounds()?))).collect();
        let mut tree = Tree { nodes: Vec::with_capacity(2 * items.len()) };
        if !items.is_empty() {
            tree.nodes.push(Node::EMPTY);
            tree.build(0, &mut items);
        }
        tree
    }

    fn build(&mut self, at: usize, items: &mut [(u32, Bounds)]) -> Bounds {
        if let [(lamp, bounds)] = items {
            self.nodes[at] = Node::new(bounds, Content::Lamp(*lamp));
            return bounds.clone();
        }
        let middle = |b: &Bounds| b.low + b.high;
        let low = items.iter().map(|(_, b)| middle(b)).fold(Vec3::INFINITY, Vec3::min);
        let high = items.iter().map(|(_, b)| middle(b)).fold(Vec3::NEG_INFINITY, Vec3::max);
        let axis = (high - low).max_position();
        let half = items.len() / 2;
        // Ties are broken by the index, so that the halves are always the same.
        items
            .select_nth_unstable_by(half, |a, b| middle(&a.1)[axis].total_cmp(&middle(&b.1)[axis]).then(a.0.cmp(&b.0)));
        let children = self.nodes.len();
        self.nodes.extend([Node::EMPTY; 2]);
        let (left, right) = items.split_at_mut(half);
        let bounds = self.build(children, left).union(&self.build(children + 1, right));
        self.nodes[at] = Node::new(&bounds, Content::Children(children as u32));
        bounds
    }

    /// The whole tree as seen by `receiver`; none if it gives it nothing.
    pub fn root(&self, receiver: &Ball) -> Option<Branch> {
        self.branch(0, receiver)
    }

    fn branch(&self, node: u32, receiver: &Ball) -> Option<Branch> {
        let importance = self.nodes.get(node as usize)?.importance(receiver);
        (importance > 0.0).then_some(Branch { node, importance, peak: f32::INFINITY })
    }

    /// The lamp, if the branch is a single one.
    pub fn lamp(&self, branch: Branch) -> Option<u32> {
        match self.nodes[branch.node as usize].content {
            Content::Lamp(lamp) => Some(lamp),
            Content::Children(_) => None,
        }
    }

    /// Whether some of the branch may lie within so many `radii` of the receiver.
    pub fn is_near(&self, branch: Branch, receiver: &Ball, radii: f32) -> bool {
        self.nodes[branch.node as usize].distance(receiver.centre) <= radii * receiver.radius
    }

    /// Whether some lamp that may give light lies within so many `radii` of the receiver.
    pub fn has_near(&self, receiver: &Ball, radii: f32) -> bool {
        let mut open: Vec<Branch> = self.root(receiver).into_iter().collect();
        while let Some(branch) = open.pop() {
            if !self.is_near(branch, receiver, radii) {
                continue;
            }
            match self.nodes[branch.node as usize].content {
                Content::Lamp(_) => return true,
                Content::Children(first) => open.extend(self.children(first, receiver).into_iter().flatten()),
            }
        }
        false
    }

    fn children(&self, first: u32, receiver: &Ball) -> [Option<Branch>; 2] {
        [self.branch(first, receiver), self.branch(first + 1, receiver)]
    }

    /// Splits the branches of `cut` that may hold the brightest lamps until it holds `limit` of them or only lamps.
    /// Branches that give nothing leave it.
    ///
    /// By their importance alone wide branches around the receiver would stay whole: the lamp next to it would be picked
    /// hardly ever, and outshine everything when it is.
    pub fn refine(&self, cut: &mut Vec<Branch>, limit: usize, receiver: &Ball) {
        while cut.len() < limit {
            let widest = (0..cut.len())
                .filter(|&i| self.lamp(cut[i]).is_none())
                .max_by(|&i, &j| cut[i].peak.total_cmp(&cut[j].peak).then(j.cmp(&i)));
            let Some(i) = widest else { return };
            let branch = cut.swap_remove(i);
            if let Content::Children(first) = self.nodes[branch.node as usize].content {
                let peak = |b: Branch| self.nodes[b.node as usize].peak(receiver, b.importance);
                let children = self.children(first, receiver).into_iter().flatten();
                cut.extend(children.map(|b| Branch { peak: peak(b), ..b }));
            }
        }
    }

    /// A lamp below `branch` and the probability of the pick, by `u` in [0, 1); none if all give nothing to `x`.
    pub fn pick(&self, branch: Branch, x: &Ball, mut u: f32) -> Option<(u32, f64)> {
        let (mut branch, mut probability) = (branch, 1.0_f64);
        loop {
            let first = match self.nodes[branch.node as usize].content {
                Content::Lamp(lamp) => return Some((lamp, probability)),
                Content::Children(first) => first,
            };
            branch = match self.children(first, x) {
                [None, None] => return None,
                [Some(only), None] | [None, Some(only)] => only,
                [Some(a), Some(b)] => {
                    let share = a.importance / (a.importance + b.importance);
                    if u < share {
                        u /= share;
                        probability *= share as f64;
                        a
                    } else {
                        u = ((u - share) / (1.0 - share)).min(0.999_999_94);
                        probability *= 1.0 - share as f64;
                        b
                    }
                }
            };
        }
    }
}

impl Node {
    /// Holds a place until its children are known.
    const EMPTY: Node = Node {
        centre: Vec3::ZERO,
        half: Vec3::ZERO,
        radius: 0.0,
        axis: Vec3::ZERO,
        cos_spread: 1.0,
        sin_spread: 0.0,
        strength: 0.0,
        content: Content::Lamp(0),
    };

    fn new(b: &Bounds, content: Content) -> Node {
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
    fn importance(&self, receiver: &Ball) -> f32 {
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
    fn peak(&self, receiver: &Ball, importance: f32) -> f32 {
        let d2 = self.centre.distance_squared(receiver.centre);
        let radius = self.radius + receiver.radius;
        let nearest = (self.distance(receiver.centre) - receiver.radius).max(NEAREST * self.radius);
        bounded(importance * d2.max(0.25 * radius * radius) / (nearest * nearest).max(f32::MIN_POSITIVE))
    }

    /// Distance of a place from the box.
    fn distance(&self, place: Vec3) -> f32 {
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
    fn union(&self, other: &Bounds) -> Bounds {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{light::lamp::Lamp, sampling::hash, scene::Light};

    fn unit(i: u64, k: u64) -> f32 {
        hash(&[i, k]) as f32 / u64::MAX as f32
    }

    fn direction(i: u64, k: u64) -> Vec3 {
        (Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2)) - 0.5).normalize_or(Vec3::X)
    }

    fn lamps() -> Vec<Lamp> {
        let lamp = |i: u64| {
            let corner = Vec3::new(unit(i, 0), unit(i, 1), unit(i, 2)) - 0.5;
            // Clusters that look the same way, so that whole nodes can face away.
            let edge_u = direction(i / 40, 3) * 0.05;
            Lamp::new(&match i % 4 {
                0 => Light::Point { position: corner, intensity: Vec3::ONE, range: 1.0 },
                1 => Light::Spot {
                    position: corner,
                    direction: direction(i / 40, 6),
                    intensity: Vec3::ONE,
                    cos_inner: 0.9,
                    cos_outer: 0.5,
                    range: 2.0,
                },
                2 => Light::Disc { centre: corner, normal: direction(i / 40, 9), radius: 0.02, radiance: Vec3::ONE },
                _ => {
                    let edge_v = edge_u.any_orthogonal_vector();
                    Light::Rectangle { corner, edge_u, edge_v, radiance: Vec3::ONE }
                }
            })
        };
        (0..400).filter_map(lamp).collect()
    }

    #[test]
    fn no_lamp_that_gives_light_is_ever_left_out() {
        let lamps = lamps();
        let tree = Tree::new(&lamps);
        let (mut given, mut left_out) = (0, 0);
        for i in 0..300 {
            let centre = Vec3::new(unit(i, 20), unit(i, 21), unit(i, 22)) - 0.5;
            let normal = direction(i, 23);
            // A single point, or points of a bent patch.
            let points: Vec<SurfacePoint> = (0..1 + 7 * (i % 2))
                .map(|k| {
                    let bend = (i % 2) as f32 * 0.3 * direction(k, 26);
                    SurfacePoint { position: centre + 0.1 * bend, normal: (normal + bend).normalize() }
                })
                .collect();
            let ball = if points.len() == 1 { Ball::point(&points[0]) } else { Ball::around(&points) };
            let mut cut: Vec<Branch> = tree.root(&ball).into_iter().collect();
            tree.refine(&mut cut, usize::MAX, &ball);
            let kept: Vec<u32> = cut.iter().filter_map(|&b| tree.lamp(b)).collect();
            assert_eq!(kept.len(), cut.len());
            for (k, lamp) in lamps.iter().enumerate() {
                let gives = points.iter().any(|x| lamp.unshadowed(x) > 1e-12);
                let kept = kept.contains(&(k as u32));
                assert!(kept || !gives, "receiver {i}, lamp {k}");
                given += gives as u32;
                left_out += !kept as u32;
            }
        }
        // The test is about both kinds.
        assert!(given > 10_000 && left_out > 10_000, "{given} {left_out}");
    }

    #[test]
    fn picks_come_as_often_as_their_probability_says() {
        let lamps = lamps();
        let tree = Tree::new(&lamps);
        let ball = Ball::point(&SurfacePoint { position: Vec3::ZERO, normal: Vec3::Y });
        let root = tree.root(&ball).unwrap();
        let n = 1 << 16;
        let mut counts = vec![(0_u32, 0.0_f64); lamps.len()];
        let mut dead = 0;
        for i in 0..n {
            match tree.pick(root, &ball, (i as f32 + 0.5) / n as f32) {
                Some((lamp, probability)) => {
                    counts[lamp as usize].0 += 1;
                    counts[lamp as usize].1 = probability;
                }
                None => dead += 1,
            }
        }
        for (k, &(count, probability)) in counts.iter().enumerate() {
            // A lamp owns one interval of u: the count is its length times n, but for the ends and for the digits of
            // u that the choices above it have used up.
            let expected = probability * n as f64;
            assert!((count as f64 - expected).abs() < 2.0 + 1e-3 * expected, "lamp {k}: {count}, {expected}");
        }
        let total: f64 = counts.iter().map(|c| c.1).sum();
        assert!((total + dead as f64 / n as f64 - 1.0).abs() < 0.01, "{total} {dead}");
    }
}
