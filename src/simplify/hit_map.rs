//! From a ray's hit to the fragment that was hit.

use glam::Vec2;
use rayon::prelude::*;

use super::{
    Fragments, Grid,
    clip::{depth_inside, uv_centroid},
    corners, normal_of,
};
use crate::trace::{Geometry, Hit};

/// A table of cells for each triangle, along the grid's lines on its dominant plane: nearly every cell holds one
/// fragment, so that a lookup is one multiplication and one load.
pub struct HitMap {
    triangles: Vec<Cells>,
    /// A fragment, or `LIST | position in lists` where several fragments share the cell.
    cells: Vec<u32>,
    /// Runs of: number of fragments, fragments.
    lists: Vec<u32>,
}

const LIST: u32 = 1 << 31;

/// Where a triangle's cells are: cell (x, y) = floor(base + u * du + v * dv), clamped to the table.
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    base: Vec2,
    du: Vec2,
    dv: Vec2,
    first: u32,
    width: u16,
    height: u16,
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
        let mut map =
            HitMap { triangles: Vec::with_capacity(geometry.triangles.len()), cells: Vec::new(), lists: Vec::new() };
        for chunk in chunks {
            let (cells, lists) = (map.cells.len() as u32, map.lists.len() as u32);
            map.triangles.extend(chunk.triangles.iter().map(|c| Cells { first: c.first + cells, ..*c }));
            map.cells.extend(chunk.cells.iter().map(|&c| if c & LIST != 0 { c + lists } else { c }));
            map.lists.extend(chunk.lists);
        }
        map
    }

    /// The fragment at a hit; `fragments` are those that the table was made of.
    #[inline]
    pub fn fragment(&self, fragments: &Fragments, hit: &Hit) -> usize {
        let c = &self.triangles[hit.triangle()];
        let at = c.base + hit.u * c.du + hit.v * c.dv;
        // Casts saturate: below zero is zero.
        let x = (at.x as u32).min(c.width as u32 - 1);
        let y = (at.y as u32).min(c.height as u32 - 1);
        let cell = self.cells[(c.first + y * c.width as u32 + x) as usize];
        if cell & LIST == 0 { cell as usize } else { self.search(fragments, cell & !LIST, Vec2::new(hit.u, hit.v)) }
    }

    /// Of the fragments in a list, the one that holds `p` best.
    #[cold]
    fn search(&self, fragments: &Fragments, list: u32, p: Vec2) -> usize {
        let list = list as usize;
        let mut best = (f32::NEG_INFINITY, 0);
        for &f in &self.lists[list + 1..list + 1 + self.lists[list] as usize] {
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
    cells: Vec<u32>,
    lists: Vec<u32>,
}

impl Chunk {
    fn add(&mut self, geometry: &Geometry, fragments: &Fragments, grid: &Grid, t: usize, own: std::ops::Range<u32>) {
        let first = self.cells.len() as u32;
        let one_cell = Cells { first, width: 1, height: 1, ..Cells::default() };
        if own.len() == 1 {
            self.cells.push(own.start);
            return self.triangles.push(one_cell);
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
        let size = flat[0].max(flat[1]).max(flat[2]).floor() - low + 1.0;
        let (width, height) = (size.x as usize, size.y as usize);
        // Long thin slanted triangles would have mostly empty cells: they keep one list.
        if width * height > 4 * own.len() + 16 {
            self.cells.push(LIST | self.lists.len() as u32);
            self.lists.push(own.len() as u32);
            self.lists.extend(own);
            return self.triangles.push(one_cell);
        }
        let base = flat[0] - low;
        let cell_of = |uv: Vec2| {
            let p = base + (flat[1] - flat[0]) * uv.x as f64 + (flat[2] - flat[0]) * uv.y as f64;
            ((p.x as usize).min(width - 1), (p.y as usize).min(height - 1))
        };
        let mut by_cell: Vec<(usize, u32)> = own
            .map(|f| {
                let (cx, cy) = cell_of(uv_centroid(fragments.uv(f as usize)));
                (cy * width + cx, f)
            })
            .collect();
        by_cell.sort_unstable();
        let mut cells = vec![u32::MAX; width * height];
        for run in by_cell.chunk_by(|a, b| a.0 == b.0) {
            cells[run[0].0] = if run.len() == 1 {
                run[0].1
            } else {
                let list = LIST | self.lists.len() as u32;
                self.lists.push(run.len() as u32);
                self.lists.extend(run.iter().map(|r| r.1));
                list
            };
        }
        fill_empty(&mut cells, width);
        self.cells.extend(cells);
        self.triangles.push(Cells {
            base: base.as_vec2(),
            du: (flat[1] - flat[0]).as_vec2(),
            dv: (flat[2] - flat[0]).as_vec2(),
            first,
            width: width as u16,
            height: height as u16,
        });
    }
}

/// Gives empty cells the value of a filled neighbour: rounding may reach one cell beyond the triangle, never more.
fn fill_empty(cells: &mut [u32], width: usize) {
    let any = *cells.iter().find(|&&c| c != u32::MAX).expect("a triangle has a fragment");
    let filled: Vec<u32> = (0..cells.len())
        .map(|i| {
            let (x, y, height) = (i % width, i / width, cells.len() / width);
            let near = |n: usize, limit: usize| n.saturating_sub(1)..(n + 2).min(limit);
            if cells[i] != u32::MAX {
                return cells[i];
            }
            near(y, height)
                .flat_map(|y| near(x, width).map(move |x| y * width + x))
                .map(|j| cells[j])
                .find(|&c| c != u32::MAX)
                .unwrap_or(any)
        })
        .collect();
    cells.copy_from_slice(&filled);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_cells_take_the_value_of_a_neighbour() {
        let mut cells = [u32::MAX, 7, u32::MAX, u32::MAX, u32::MAX, u32::MAX];
        fill_empty(&mut cells, 3);
        assert_eq!(cells, [7; 6]);
    }
}
