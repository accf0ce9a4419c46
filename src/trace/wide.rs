//! A tree of boxes, eight to a node, tested all at once.

use glam::{Vec3, Vec3A};
use obvhs::{aabb::Aabb, cwbvh::CwBvh};

/// Boxes a node.
pub const LANES: usize = 8;

/// One number for each box of a node.
type Lanes = [f32; LANES];

/// Where a box leads.
#[derive(Clone, Copy, Default)]
pub struct Child(u32);

/// What a [`Child`] stands for.
pub enum Inside {
    /// A node, by its number.
    Node(usize),
    /// Triangles, in the order of the leaves.
    Triangles(std::ops::Range<usize>),
}

/// What a [`Child`] has numbers for.
pub const MOST_TRIANGLES: usize = 1 << 29;

/// This bit marks triangles: the position of the first, then their number in two bits.
const LEAF: u32 = 1 << 31;

impl Child {
    /// The first node.
    pub const ROOT: Child = Child(0);

    fn triangles(first: u32, count: u32) -> Child {
        Child(LEAF | first << 2 | count)
    }

    #[inline(always)]
    pub fn inside(self) -> Inside {
        if self.0 & LEAF == 0 {
            return Inside::Node(self.0 as usize);
        }
        let (first, count) = ((self.0 & !LEAF) >> 2, self.0 & 3);
        Inside::Triangles(first as usize..(first + count) as usize)
    }
}

/// A node. The planes of its boxes are kept as they are: the eight-bit ones of obvhs take a third of the memory but more
/// than twice the time, and what is met beyond a hit cannot be told from them without unpacking a node again.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub struct Node {
    /// Low and high x, low and high y, low and high z.
    planes: [Lanes; 6],
    child: [Child; LANES],
}

/// What a ray needs to meet boxes.
pub struct Slabs {
    origin: Vec3A,
    /// Of the direction's components; finite.
    inverse: Vec3A,
    /// For each axis, which of its planes is met last.
    last: [usize; 3],
}

impl Slabs {
    /// A ray; `inverse` holds the finite inverses of its direction's components.
    #[inline(always)]
    pub fn new(origin: Vec3A, direction: Vec3A, inverse: Vec3A) -> Slabs {
        let rising = |d: f32| (d >= 0.0) as usize;
        Slabs { origin, inverse, last: [rising(direction.x), rising(direction.y), rising(direction.z)] }
    }
}

/// The boxes of a node that a ray meets.
pub struct Met<'a> {
    node: &'a Node,
    /// Where the ray enters the boxes.
    near: Lanes,
    /// One bit for each box that is still to be told.
    left: u32,
}

impl Iterator for Met<'_> {
    /// A child and the distance of its box.
    type Item = (Child, f32);

    #[inline(always)]
    fn next(&mut self) -> Option<(Child, f32)> {
        if self.left == 0 {
            return None;
        }
        let k = self.left.trailing_zeros() as usize % LANES;
        self.left &= self.left - 1;
        Some((self.node.child[k], self.near[k]))
    }
}

impl Node {
    /// No boxes: low planes beyond all high ones, which no ray meets.
    fn empty() -> Node {
        let [low, high] = [[f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]];
        Node { planes: [low, high, low, high, low, high], child: [Child::default(); LANES] }
    }

    fn put(&mut self, k: usize, bounds: Aabb, child: Child) {
        for axis in 0..3 {
            self.planes[2 * axis][k] = bounds.min[axis];
            self.planes[2 * axis + 1][k] = bounds.max[axis];
        }
        self.child[k] = child;
    }

    /// The boxes that a ray meets before `farthest`.
    #[inline(always)]
    pub fn meets(&self, ray: &Slabs, farthest: f32) -> Met<'_> {
        let at = |axis: usize, side: usize| {
            let (planes, o, i) = (&self.planes[2 * axis + side], ray.origin[axis], ray.inverse[axis]);
            each(|k| (planes[k] - o) * i)
        };
        let [x, y, z] = ray.last;
        let near = larger(larger(at(0, 1 - x), at(1, 1 - y)), larger(at(2, 1 - z), [0.0; LANES]));
        let far = smaller(smaller(at(0, x), at(1, y)), smaller(at(2, z), [farthest; LANES]));
        let mut met = [0u8; LANES];
        for k in 0..LANES {
            met[k] = (near[k] <= far[k]) as u8;
        }
        // Through memory, or the compiler takes the eight comparisons apart, and what they compare with them: twice the time.
        let met = u64::from_le_bytes(*std::hint::black_box(&met));
        // Puts the lowest bits of eight bytes side by side.
        let left = (met.wrapping_mul(0x0102_0408_1020_4080) >> 56) as u32;
        Met { node: self, near, left }
    }
}

// Plain loops: closures of the standard library's array functions are not always compiled for the caller's vectors.
#[inline(always)]
fn each(value: impl Fn(usize) -> f32) -> Lanes {
    let mut lanes = [0.0; LANES];
    for (k, lane) in lanes.iter_mut().enumerate() {
        *lane = value(k);
    }
    lanes
}

// As the vector instructions have it: the second where one is no number.
#[inline(always)]
fn larger(a: Lanes, b: Lanes) -> Lanes {
    each(|k| if a[k] > b[k] { a[k] } else { b[k] })
}

#[inline(always)]
fn smaller(a: Lanes, b: Lanes) -> Lanes {
    each(|k| if a[k] < b[k] { a[k] } else { b[k] })
}

/// The nodes of `tree` with exact boxes, which it must have kept; boxes of `triangles`, in the order of its leaves, are grown
/// by `margin`.
pub fn widen(tree: &CwBvh, triangles: &[[Vec3; 3]], margin: f32) -> Vec<Node> {
    let exact = tree.exact_node_aabbs.as_deref().unwrap_or_default();
    let wide = |narrow: &obvhs::cwbvh::node::CwBvhNode| {
        let mut node = Node::empty();
        for k in (0..LANES).filter(|&k| !narrow.is_child_empty(k)) {
            if narrow.is_leaf(k) {
                let (first, count) = narrow.child_primitives(k);
                let own = &triangles[first as usize..(first + count) as usize];
                let corners: Vec<Vec3A> = own.as_flattened().iter().map(|&p| p.into()).collect();
                let bounds = Aabb::from_points(&corners);
                let margin = Vec3A::splat(margin);
                node.put(k, Aabb::new(bounds.min - margin, bounds.max + margin), Child::triangles(first, count));
            } else {
                let child = narrow.child_node_index(k);
                node.put(k, exact[child as usize], Child(child));
            }
        }
        node
    };
    tree.nodes.iter().map(wide).collect()
}
