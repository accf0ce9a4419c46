//! Connected components of the triangles, and a common winding for each.

use super::{Triangle, weld};
use glam::Vec3;

/// The component of every triangle, and what is known of every component.
pub(crate) struct Components {
    /// Component of every triangle, numbered by first triangle.
    pub of: Vec<u32>,
    /// Whether the triangle must be turned so that its component is wound alike.
    pub turn: Vec<bool>,
    pub list: Vec<Component>,
}

pub(crate) struct Component {
    /// Its triangles, ascending.
    pub triangles: Vec<u32>,
    /// Whether a common winding exists.
    pub orientable: bool,
    /// Whether every edge is walked as often in one direction as in the other: the surface has no border.
    pub closed: bool,
}

/// An edge of a triangle between two places, the lower one first.
#[derive(Clone, Copy)]
struct Edge {
    ends: [u32; 2],
    triangle: u32,
    /// Whether the triangle walks it from the lower to the higher place.
    forward: bool,
}

/// Finds the components.
///
/// Triangles are neighbours if they are the only two at an edge; where more meet (a partition on a wall, two blocks
/// edge to edge) they are not, so that every solid keeps to itself. Positions are welded first.
/// O(n log n) in the number of triangles.
pub(crate) fn components(positions: &[Vec3], triangles: &[Triangle]) -> Components {
    let place = weld::nearby(positions);
    let corners: Vec<[u32; 3]> = triangles.iter().map(|t| t.vertices.map(|v| place[v as usize])).collect();
    // A triangle that welding collapses takes no part: its neighbours meet where it was.
    let is_sliver = |[a, b, c]: [u32; 3]| a == b || b == c || c == a;
    let mut edges: Vec<Edge> = Vec::with_capacity(3 * corners.len());
    for (c, t) in corners.iter().zip(0..).filter(|(c, _)| !is_sliver(**c)) {
        for k in 0..3 {
            let (a, b) = (c[k], c[(k + 1) % 3]);
            edges.push(Edge { ends: [a.min(b), a.max(b)], triangle: t, forward: a < b });
        }
    }
    edges.sort_unstable_by_key(|e| (e.ends, e.triangle));

    // At most one neighbour an edge; `true` if both walk the edge the same way, so that one must turn.
    let mut neighbours: Vec<[Option<(u32, bool)>; 3]> = vec![[None; 3]; corners.len()];
    for pair in edges.chunk_by(|a, b| a.ends == b.ends).filter(|g| g.len() == 2) {
        let same = pair[0].forward == pair[1].forward;
        for (one, other) in [(pair[0], pair[1]), (pair[1], pair[0])] {
            if let Some(slot) = neighbours[one.triangle as usize].iter_mut().find(|s| s.is_none()) {
                *slot = Some((other.triangle, same));
            }
        }
    }

    let mut found =
        Components { of: vec![u32::MAX; corners.len()], turn: vec![false; corners.len()], list: Vec::new() };
    for (seed, c) in corners.iter().enumerate() {
        if found.of[seed] == u32::MAX && !is_sliver(*c) {
            found.flood(seed as u32, &neighbours);
        }
    }
    found.adopt_slivers(&corners);
    found.find_closed(&edges);
    found
}

impl Components {
    fn flood(&mut self, seed: u32, neighbours: &[[Option<(u32, bool)>; 3]]) {
        let number = self.list.len() as u32;
        let mut component = Component { triangles: vec![seed], orientable: true, closed: false };
        self.of[seed as usize] = number;
        let mut next = 0;
        while let Some(&t) = component.triangles.get(next) {
            next += 1;
            for &(other, same) in neighbours[t as usize].iter().flatten() {
                let turn = self.turn[t as usize] ^ same;
                if self.of[other as usize] == u32::MAX {
                    self.of[other as usize] = number;
                    self.turn[other as usize] = turn;
                    component.triangles.push(other);
                } else if self.turn[other as usize] != turn {
                    component.orientable = false;
                }
            }
        }
        component.triangles.sort_unstable();
        let turned = component.triangles.iter().filter(|&&t| self.turn[t as usize]).count();
        let majority = 2 * turned > component.triangles.len();
        for &t in &component.triangles {
            // The winding of most triangles stays; without a common winding, that of all does.
            self.turn[t as usize] = component.orientable && (self.turn[t as usize] ^ majority);
        }
        self.list.push(component);
    }

    /// Slivers join the component of a neighbour by vertex, or are one of their own.
    fn adopt_slivers(&mut self, corners: &[[u32; 3]]) {
        let places = corners.iter().flatten().max().map_or(0, |m| *m as usize + 1);
        let mut at_place = vec![u32::MAX; places];
        for (c, &component) in corners.iter().zip(&self.of).filter(|(_, of)| **of != u32::MAX) {
            for &p in c {
                at_place[p as usize] = component;
            }
        }
        for (t, c) in corners.iter().enumerate().filter(|(t, _)| self.of[*t] == u32::MAX).collect::<Vec<_>>() {
            let known = c.iter().map(|&p| at_place[p as usize]).find(|&k| k != u32::MAX);
            self.of[t] = known.unwrap_or(self.list.len() as u32);
            match known {
                Some(k) => self.list[k as usize].triangles.push(t as u32),
                None => self.list.push(Component { triangles: vec![t as u32], orientable: true, closed: false }),
            }
        }
    }

    fn find_closed(&mut self, edges: &[Edge]) {
        // Forward less backward walks of every edge within its component.
        let mut walks: Vec<(u32, [u32; 2], i32)> = (edges.iter())
            .map(|e| {
                let t = e.triangle as usize;
                (self.of[t], e.ends, if e.forward ^ self.turn[t] { 1 } else { -1 })
            })
            .collect();
        walks.sort_unstable();
        let mut closed: Vec<bool> = self.list.iter().map(|c| c.orientable && c.triangles.len() >= 4).collect();
        for group in walks.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            if group.iter().map(|w| w.2).sum::<i32>() != 0 {
                closed[group[0].0 as usize] = false;
            }
        }
        for (component, closed) in self.list.iter_mut().zip(closed) {
            component.closed = closed;
        }
    }
}
