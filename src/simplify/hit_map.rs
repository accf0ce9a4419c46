//! From a ray's hit to the patch that was hit.

use glam::Vec2;
use rayon::prelude::*;

use super::{
    Fragments, Grid,
    clip::{depth_inside, uv_centroid},
    corners, normal_of,
};
use crate::trace::{Geometry, Hit};

/// A table of cells for each triangle, along the grid's lines on its dominant plane: nearly every cell holds one
/// fragment, so that a lookup is a multiplication and a few loads. A row of cells covers what the triangle covers, so
/// the table is no larger than the list of fragments even where triangles are long and thin.
pub struct HitMap {
    triangles: Vec<Cells>,
    rows: Vec<Row>,
    /// Patches of the front and of the back, or [[`LIST`], position in lists] where several fragments share the cell.
    cells: Vec<[u32; 2]>,
    /// Runs of: number of fragments, fragments; and where these are two, the bits of the line that parts them.
    lists: Vec<u32>,
}

/// No patch has this number; nor is it [`super::NO_PATCH`].
const LIST: u32 = u32::MAX - 1;

/// Where a triangle's cells are: cell (x, y) = floor(base + u * du + v * dv), clamped to the table.
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    base: Vec2,
    du: Vec2,
    dv: Vec2,
    first_row: u32,
    last_row: u32,
}

/// The cells x0 ..= x0 + last of one y.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    first: u32,
    x0: u16,
    last: u16,
}

impl HitMap {
    /// Builds the table. `fragments` are sorted by triangle and each triangle has at least one.
    pub fn new(geometry: &Geometry, fragments: &Fragments, grid: &Grid) -> HitMap {
        let mut first = vec![0u32; geometry.triangles.len() + 1];
        for &t in &fragments.triangle {
            first[t as usize + 1] += 1;
        }
        for t in 0..geometry.triangles.len() {
            first[t + 1] += first[t];
        }
        let chunks: Vec<Chunk> = (0..geometry.triangles.len())
            .collect::<Vec<_>>()
            .par_chunks(1024)
            .map(|triangles| {
                let mut chunk = Chunk::default();
                for &t in triangles {
                    chunk.add(geometry, fragments, grid, t, first[t]..first[t + 1]);
                }
                chunk
            })
            .collect();
        let mut map = HitMap {
            triangles: Vec::with_capacity(geometry.triangles.len()),
            rows: Vec::new(),
            cells: Vec::with_capacity(fragments.len()),
            lists: Vec::new(),
        };
        for chunk in chunks {
            let (rows, cells, lists) = (map.rows.len() as u32, map.cells.len() as u32, map.lists.len() as u32);
            map.triangles.extend(chunk.triangles.iter().map(|c| Cells { first_row: c.first_row + rows, ..*c }));
            map.rows.extend(chunk.rows.iter().map(|r| Row { first: r.first + cells, ..*r }));
            map.cells.extend(chunk.cells.iter().map(|&[c, at]| [c, if c == LIST { at + lists } else { at }]));
            map.lists.extend(chunk.lists);
        }
        map
    }

    /// The patch at a hit, [`super::NO_PATCH`] inside objects; `fragments` are those that the table was made of.
    #[inline]
    pub fn patch(&self, fragments: &Fragments, hit: &Hit) -> u32 {
        let c = &self.triangles[hit.triangle()];
        let at = c.base + hit.u * c.du + hit.v * c.dv;
        // Casts saturate, below zero too.
        let y = (at.y as i32).clamp(0, c.last_row as i32) as u32;
        let row = self.rows[(c.first_row + y) as usize];
        let x = (at.x as i32 - row.x0 as i32).clamp(0, row.last as i32) as u32;
        let cell = self.cells[(row.first + x) as usize];
        let side = hit.is_back() as usize;
        if cell[0] != LIST {
            return cell[side];
        }
        fragments.patch[self.search(fragments, cell[1] as usize, Vec2::new(hit.u, hit.v))][side]
    }

    /// Of the fragments in a list, the one that holds `p` best.
    fn search(&self, fragments: &Fragments, list: usize, p: Vec2) -> usize {
        let count = self.lists[list] as usize;
        let own = &self.lists[list + 1..];
        if count == 2 {
            let [a, b, c] = [own[2], own[3], own[4]].map(f32::from_bits);
            return own[(a * p.x + b * p.y + c < 0.0) as usize] as usize;
        }
        let mut best = (f32::NEG_INFINITY, own[0] as usize);
        for &f in &own[..count] {
            let depth = depth_inside(fragments.uv(f as usize), p);
            if depth > best.0 {
                best = (depth, f as usize);
            }
        }
        best.1
    }
}

#[derive(Default)]
struct Chunk {
    triangles: Vec<Cells>,
    rows: Vec<Row>,
    cells: Vec<[u32; 2]>,
    lists: Vec<u32>,
}

impl Chunk {
    fn add(&mut self, geometry: &Geometry, fragments: &Fragments, grid: &Grid, t: usize, own: std::ops::Range<u32>) {
        let first_row = self.rows.len() as u32;
        if own.len() == 1 {
            self.rows.push(Row { first: self.cells.len() as u32, x0: 0, last: 0 });
            self.cells.push(fragments.patch[own.start as usize]);
            return self.triangles.push(Cells { first_row, ..Cells::default() });
        }
        // Project on the plane of the dominant axis, in voxels.
        let corners = corners(geometry, t);
        let n = normal_of(&corners).abs();
        let (x, y) = if n.x >= n.y && n.x >= n.z {
            (1, 2)
        } else if n.y >= n.z {
            (2, 0)
        } else {
            (0, 1)
        };
        let flat = corners.map(|p| {
            let p = (p.as_dvec3() - grid.origin) / grid.voxel_size;
            glam::DVec2::new(p[x], p[y])
        });
        let low = flat[0].min(flat[1]).min(flat[2]).floor();
        let base = flat[0] - low;
        let cell_of = |uv: Vec2| {
            let p = base + (flat[1] - flat[0]) * uv.x as f64 + (flat[2] - flat[0]) * uv.y as f64;
            (p.y as u16, p.x as u16)
        };
        let mut by_cell: Vec<((u16, u16), u32)> =
            own.map(|f| (cell_of(uv_centroid(fragments.uv(f as usize))), f)).collect();
        by_cell.sort_unstable();
        let last_row = by_cell[by_cell.len() - 1].0.0;
        for row in by_cell.chunk_by(|a, b| a.0.0 == b.0.0) {
            // Rows without a fragment hold no more than rounding dust: they share the next row.
            let y = row[0].0.0 as u32;
            let (first, x0) = (self.cells.len() as u32, row[0].0.1);
            for cell in row.chunk_by(|a, b| a.0.1 == b.0.1) {
                let entry = self.entry(fragments, cell);
                // Cells without one share the cell after them.
                self.cells.resize(first as usize + (cell[0].0.1 - x0) as usize + 1, entry);
            }
            let row = Row { first, x0, last: (self.cells.len() as u32 - first - 1) as u16 };
            self.rows.resize((first_row + y) as usize + 1, row);
        }
        self.triangles.push(Cells {
            base: base.as_vec2(),
            du: (flat[1] - flat[0]).as_vec2(),
            dv: (flat[2] - flat[0]).as_vec2(),
            first_row,
            last_row: last_row as u32,
        });
    }

    /// What a cell with these fragments holds.
    fn entry(&mut self, fragments: &Fragments, own: &[((u16, u16), u32)]) -> [u32; 2] {
        if let [only] = own {
            return fragments.patch[only.1 as usize];
        }
        let entry = [LIST, self.lists.len() as u32];
        self.lists.push(own.len() as u32);
        self.lists.extend(own.iter().map(|o| o.1));
        if let [a, b] = own {
            let line = parting_line(fragments.uv(a.1 as usize), fragments.uv(b.1 as usize));
            self.lists.extend(line.map(f32::to_bits));
        }
        entry
    }
}

/// A line (a, b, c) with a u + b v + c > 0 on the first of two convex polygons that do not overlap: that edge of
/// either which parts them best.
fn parting_line(first: &[Vec2], second: &[Vec2]) -> [f32; 3] {
    let mut best = (f32::INFINITY, [0.0, 0.0, 1.0]);
    for (own, other, sign) in [(first, second, 1.0), (second, first, -1.0)] {
        for (i, &p) in own.iter().enumerate() {
            let edge = (own[(i + 1) % own.len()] - p).normalize_or_zero();
            // Positive inside the polygon that owns the edge.
            let line = Vec2::new(-edge.y, edge.x);
            let overlap = other.iter().map(|&q| line.dot(q - p)).fold(f32::NEG_INFINITY, f32::max);
            if edge != Vec2::ZERO && overlap < best.0 {
                best = (overlap, [sign * line.x, sign * line.y, -sign * line.dot(p)]);
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parting_line_has_one_polygon_on_each_side() {
        let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let beside = square.map(|p| p + Vec2::new(1.0, 0.5));
        for (first, second) in [(square, beside), (beside, square)] {
            let [a, b, c] = parting_line(&first, &second);
            let middle = |p: [Vec2; 4]| p.iter().sum::<Vec2>() / 4.0;
            assert!(a * middle(first).x + b * middle(first).y + c > 0.4);
            assert!(a * middle(second).x + b * middle(second).y + c < -0.4);
        }
    }
}
