//! A tree over many lamps: picks one with a probability near its share, without visiting all.
//!
//! After Conty Estevez & Kulla 2018 ("Importance sampling of many lights with adaptive tree splitting"): nodes know a
//! box, a cone of normals and a strength. The importance is zero only where no lamp of the node can give light, so
//! that picks are unbiased.

use glam::Vec3;

use super::{
    lamp::{Bounds, Lamp},
    node::{Ball, Content, Node},
};

#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
}

/// A part of the tree, with its importance to a receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Branch {
    node: u32,
    pub importance: f32,
    /// What it gives if all of it is as near as its nearest lamp may be; known in a cut.
    peak: f32,
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        sampling::hash,
        scene::{Light, SurfacePoint},
    };

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
