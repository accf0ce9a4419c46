//! From a ray's hit to the patch that was hit.

use glam::Vec2;
use rayon::prelude::*;

use super::{
    Fragments, Grid,
    clip::{depth_inside, share, uv_centroid},
    corners, normal_of,
};
use crate::trace::{Geometry, Hit};

/// A table of cells for each triangle, along the grid's lines on its dominant plane: nearly every cell holds one
/// fragment, so that a lookup is a multiplication and a few loads. A row of cells covers what the triangle covers, so
/// the table is no larger than the list of fragments even where triangles are long and thin.
pub struct HitMap {
    /// One more than there are triangles: the last stands for a miss.
    triangles: Vec<Cells>,
    rows: Vec<Row>,
    /// Patches of the front and of the back of each cell, or in both [`LIST`] + a position in the lists where several
    /// fragments share it. Two tables, since few scenes are seen from both sides.
    cells: [Vec<u32>; 2],
    /// Runs of: number of fragments, fragments; and where these are two, the bits of the line that parts them.
    lists: Vec<u32>,
}

/// Patches have numbers below this. Entries of a cell from here to [`NOTHING`] are positions in the lists.
const LIST: u32 = 1 << 31;

/// What [`HitMap::patches`] tells of rays that met nothing; no patch has this number.
pub const NOTHING: u32 = u32::MAX - 2;

/// Where a triangle's cells are: cell (x, y) = round(base + u * du + v * dv), clamped to the table.
///
/// Numbers of rows and columns are kept as floats, so that a clamped place becomes an index by adding [`WHOLE`].
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    /// Half a cell less than the place itself, so that rounding takes the whole part.
    base: Vec2,
    du: Vec2,
    dv: Vec2,
    first_row: u32,
    last_row: f32,
}

/// The cells x0 ..= x0 + last of one y.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    first: u32,
    x0: f32,
    last: f32,
}

/// 2^23: a float above it has no fraction, and its lowest bits are the whole number.
const WHOLE: f32 = 8_388_608.0;

/// `x` in [0, last], rounded; 0 for what is no number.
#[inline(always)]
fn clamped(x: f32, last: f32) -> u32 {
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < last { x } else { last };
    (x + WHOLE).to_bits() - WHOLE.to_bits()
}

#[inline(always)]
fn is_list(entry: u32) -> bool {
    (LIST..NOTHING).contains(&entry)
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
        let share = share(geometry.triangles.len());
        let chunks: Vec<Chunk> = (0..geometry.triangles.len().div_ceil(share))
            .into_par_iter()
            .with_max_len(1)
            .map(|k| {
                let own = k * share..geometry.triangles.len().min((k + 1) * share);
                let mut chunk = Chunk::with_room_for(own.len(), (first[own.end] - first[own.start]) as usize);
                for t in own {
                    chunk.add(geometry, fragments, grid, t, first[t]..first[t + 1]);
                }
                chunk
            })
            .collect();
        let sum = |length: fn(&Chunk) -> usize| chunks.iter().map(length).sum::<usize>();
        let cells = sum(|chunk| chunk.cells.len()) + 1;
        let mut map = HitMap {
            triangles: Vec::with_capacity(geometry.triangles.len() + 1),
            rows: Vec::with_capacity(sum(|chunk| chunk.rows.len()) + 1),
            cells: [0; 2].map(|_| Vec::with_capacity(cells)),
            lists: Vec::with_capacity(sum(|chunk| chunk.lists.len())),
        };
        for chunk in chunks {
            let (rows, cells, lists) = (map.rows.len() as u32, map.cells[0].len() as u32, map.lists.len() as u32);
            map.triangles.extend(chunk.triangles.iter().map(|c| Cells { first_row: c.first_row + rows, ..*c }));
            map.rows.extend(chunk.rows.iter().map(|r| Row { first: r.first + cells, ..*r }));
            for (side, cells) in map.cells.iter_mut().enumerate() {
                cells.extend(chunk.cells.iter().map(|c| if is_list(c[side]) { c[side] + lists } else { c[side] }));
            }
            map.lists.extend(chunk.lists);
        }
        map.triangles.push(Cells { first_row: map.rows.len() as u32, ..Cells::default() });
        map.rows.push(Row { first: map.cells[0].len() as u32, x0: 0.0, last: 0.0 });
        map.cells.iter_mut().for_each(|cells| cells.push(NOTHING));
        map
    }

    /// The patch at a hit, [`super::NO_PATCH`] inside objects; `fragments` are those that the table was made of.
    #[inline]
    pub fn patch(&self, fragments: &Fragments, hit: &Hit) -> u32 {
        let entry = self.cells[hit.is_back() as usize][self.cell(hit)];
        if is_list(entry) { self.listed(fragments, entry, hit) } else { entry }
    }

    /// The patch at every hit, [`super::NO_PATCH`] inside objects, [`NOTHING`] where nothing was met. `cells` is
    /// working memory. Returns whether all rays met patches.
    ///
    /// Each step is taken for all hits before the next, and cells of several fragments come last: so that the loads of
    /// many hits overlap, and none waits for a branch that was foretold wrongly.
    pub fn patches(&self, fragments: &Fragments, hits: &[Hit], cells: &mut Vec<u32>, patches: &mut Vec<u32>) -> bool {
        cells.clear();
        cells.extend(hits.iter().map(|hit| self.cell(hit) as u32));
        patches.clear();
        let [front, back] = &self.cells;
        let mut entries = 0;
        patches.extend(cells.iter().zip(hits).map(|(&cell, hit)| {
            let entry = if hit.is_back() { back } else { front }[cell as usize];
            entries |= entry;
            entry
        }));
        // Patches have numbers below it.
        if entries < LIST {
            return true;
        }
        let mut found = 0;
        for (patch, hit) in patches.iter_mut().zip(hits) {
            if is_list(*patch) {
                *patch = self.listed(fragments, *patch, hit);
            }
            found |= *patch;
        }
        found < LIST
    }

    /// Number of the cell at a hit; the last one if nothing was met.
    #[inline(always)]
    fn cell(&self, hit: &Hit) -> usize {
        // The last triangle stands for none.
        let c = &self.triangles[hit.triangle().min(self.triangles.len() - 1)];
        let row = self.rows[(c.first_row + clamped(c.base.y + hit.u * c.du.y + hit.v * c.dv.y, c.last_row)) as usize];
        let x = clamped(c.base.x + hit.u * c.du.x + hit.v * c.dv.x - row.x0, row.last);
        (row.first + x) as usize
    }

    #[inline]
    fn listed(&self, fragments: &Fragments, entry: u32, hit: &Hit) -> u32 {
        let fragment = self.search(fragments, (entry - LIST) as usize, Vec2::new(hit.u, hit.v));
        fragments.patch[fragment][hit.is_back() as usize]
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
    /// With room for the usual rows and cells of so many triangles and fragments.
    fn with_room_for(triangles: usize, fragments: usize) -> Chunk {
        Chunk {
            triangles: Vec::with_capacity(triangles),
            rows: Vec::with_capacity(fragments),
            cells: Vec::with_capacity(fragments),
            lists: Vec::new(),
        }
    }

    fn add(&mut self, geometry: &Geometry, fragments: &Fragments, grid: &Grid, t: usize, own: std::ops::Range<u32>) {
        let first_row = self.rows.len() as u32;
        if own.len() == 1 {
            self.rows.push(Row { first: self.cells.len() as u32, x0: 0.0, last: 0.0 });
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
        // As one number, which compares without a branch.
        by_cell.sort_unstable_by_key(|&((y, x), f)| (y as u64) << 48 | (x as u64) << 32 | f as u64);
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
            let row = Row { first, x0: x0 as f32, last: (self.cells.len() as u32 - first - 1) as f32 };
            self.rows.resize((first_row + y) as usize + 1, row);
        }
        self.triangles.push(Cells {
            base: (base - 0.5).as_vec2(),
            du: (flat[1] - flat[0]).as_vec2(),
            dv: (flat[2] - flat[0]).as_vec2(),
            first_row,
            last_row: last_row as f32,
        });
    }

    /// What a cell with these fragments holds.
    fn entry(&mut self, fragments: &Fragments, own: &[((u16, u16), u32)]) -> [u32; 2] {
        if let [only] = own {
            return fragments.patch[only.1 as usize];
        }
        let entry = [LIST + self.lists.len() as u32; 2];
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
