//! What a bake will take of the memory, once its patches are known and before its rows are cast.
//!
//! What the process holds by then is measured, not foretold: scene, ray-tracing structure, fragments and patches. The rest
//! is counted, and the bytes of a row come from a sample of them; so are corners and vertices of the split mesh. What the process
//! holds without using it, beyond code and the data whose sizes are known, serves again: how much of it, and the bytes a
//! patch and thread, are measured peaks of some scenes, with the allocator of glibc; scenes that these were not taken from tell
//! how well they hold (see ARCHITECTURE.md).

use crate::{
    lxt::map::WINDOWS_RESIDENT,
    output::report::{mapped_bytes, memory_bytes, peak_memory_bytes},
    simplify::Pieces,
    solve::UNPACKED_PATCH,
};

/// Memory of a bake, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outlook {
    /// What the process holds now; 0 where the system does not tell.
    pub held: u64,
    /// What it has held at most.
    pub peak: u64,
    /// The form factors.
    pub rows: u64,
    /// The rows that are unpacked to solve the system; not if rows are spilled. They are gone before what comes next.
    pub unpacked: u64,
    /// What solving adds besides.
    pub solved: u64,
    /// What the rest of the bake adds to that at its largest, but for what follows.
    pub rest: u64,
    /// The corners of the split mesh: one array, for which there is no room in what the rows leave.
    pub corners: u64,
    /// What is there once that array is gone, at most.
    pub later: u64,
    /// What of this is there when the bake is done, for those who go on with it.
    pub lasting: u64,
    /// What was freed before and will be used again, about.
    pub reused: u64,
    /// What of all that depends on the voxels; `None` if other voxels are no choice.
    pub voxels: Option<Voxels>,
}

/// What the memory of a bake owes to its voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Voxels {
    /// Their size, local units.
    pub size: f64,
    /// Pieces of surface with voxels of any size.
    pub pieces: Pieces,
    /// Bytes that it takes with any.
    pub without: u64,
    /// Bytes that coarser voxels take too, down to this share of the pieces; below it they take less in proportion.
    pub alike: u64,
    /// See there.
    pub down_to: f64,
}

/// What a process may take, bytes, if pictures of so many pixels are made at last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    /// Bytes at most.
    pub bytes: u64,
    /// Pixels.
    pub pixels: u64,
}

/// Share of a limit that what is suggested may take: what is foretold is within a tenth of what it will be.
pub(crate) const SUGGESTED: f64 = 0.9;

/// What an outlook is made from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    /// Bytes of what is there by now and stays.
    pub used: f64,
    pub patches: usize,
    /// Bytes of all rows together, and of those that are not there yet.
    pub row_bytes: f64,
    pub cast_bytes: f64,
    /// Corners and vertices of the split mesh.
    pub corners: usize,
    pub vertices: usize,
    pub estimate: bool,
}

/// Bytes a patch while the system is solved.
const SOLVED_PATCH: f64 = 260.0;
/// Unpacked rows against coded ones.
const UNPACKED: f64 = 1.2;
/// While the split mesh is made. Bytes a corner: as such, in one array, for which there is no room in pieces; its vertex, and
/// its part of a side of four corners (16). Bytes a vertex: its sums (28), position and normal (24).
const CORNER: f64 = 60.0;
const CORNER_OF_VERTEX: f64 = 4.0 + 4.0;
const SUMMED_VERTEX: f64 = 28.0 + 24.0;
/// When it is made. Bytes a corner: half a triangle, with source and patch (20). Bytes a vertex: position, normal, albedo, place
/// where light is computed (60), direct and indirect light (24).
const MADE_CORNER: f64 = 10.0;
const LIT_VERTEX: f64 = 60.0 + 24.0;
/// Bytes a vertex while the error is estimated: its area (8), three errors (12), and all of its light (12).
const ESTIMATED_VERTEX: f64 = 8.0 + 12.0 + 12.0;
/// While the lit mesh is written. Bytes a corner: half a triangle (12). Bytes a vertex: its errors (12), position, normal,
/// radiance and whether it is a lamp (37), the materials that it has there (20).
const WRITTEN_CORNER: f64 = 6.0;
const WRITTEN_VERTEX: f64 = 12.0 + 37.0 + 20.0;
/// Bytes a patch of what is there when the bake is done.
const LASTING_PATCH: f64 = 200.0;
/// Bytes a patch while the error is estimated.
const ESTIMATED_PATCH: f64 = 180.0;
/// Share of what the process holds without using it that serves rows and the solver: the rest lies in pieces.
const REUSED: f64 = 0.6;
/// Share of rows and solver that finds no room in what is free, however much there is.
const FRESH: u64 = 5;
/// What the heap of a thread keeps of what it has freed. That of two threads is in the other constants.
const HEAP: f64 = 2.4e6;
/// Foretold before there is anything: what the rays of the patches' direct light leave to be used again, and what all before
/// did as a share.
const LEFT: f64 = 16e6;
const LEFT_SHARE: f64 = 0.1;
/// Bytes of a stencil: place and normal (24), end (4), some eight patches with weights (8 each).
pub(crate) const STENCIL: usize = 24 + 4 + 8 * 8;
/// About half of that again while it is found.
const FOUND: usize = 48;
/// Bytes a pixel while pictures are written.
const PIXEL: f64 = 280.0;

impl Outlook {
    pub(crate) fn new(sizes: &Sizes) -> Outlook {
        let Sizes { used, patches, row_bytes, cast_bytes, corners, vertices, estimate } = *sizes;
        let (held, peak) = (memory_bytes(), peak_memory_bytes());
        let solved = patches as f64 * SOLVED_PATCH;
        let (corners, vertices) = (corners as f64, vertices as f64);
        let heaps = (rayon::current_num_threads() as f64 - 2.0) * HEAP;
        let meshed = corners * MADE_CORNER + vertices * LIT_VERTEX;
        let estimated = vertices * ESTIMATED_VERTEX + patches as f64 * ESTIMATED_PATCH;
        let written = corners * WRITTEN_CORNER + vertices * WRITTEN_VERTEX;
        let later = meshed + if estimate { estimated.max(written) } else { written };
        let lasting = patches as f64 * LASTING_PATCH + meshed;
        let unpacks = row_bytes <= patches as f64 * UNPACKED_PATCH as f64;
        let unpacked = if unpacks { UNPACKED * row_bytes } else { 0.0 };
        let reused = REUSED * (held.saturating_sub(mapped_bytes()) as f64 - used).max(0.0);
        Outlook {
            held,
            peak,
            rows: cast_bytes as u64,
            unpacked: unpacked as u64,
            solved: solved as u64,
            rest: (corners * CORNER_OF_VERTEX + vertices * SUMMED_VERTEX + heaps) as u64,
            corners: (corners * CORNER) as u64,
            later: (later + heaps) as u64,
            lasting: lasting as u64,
            reused: reused as u64,
            voxels: None,
        }
    }

    /// Of a process that makes rows and what vertices take their light from, but no light.
    pub(crate) fn of_transfer(sizes: &Sizes) -> Outlook {
        let stencils = sizes.vertices * (STENCIL + FOUND);
        Outlook { unpacked: 0, solved: 0, later: stencils as u64, lasting: 0, ..Outlook::new(sizes) }
    }

    /// Of a process that holds rows and does nothing with them.
    pub(crate) fn of_rows(row_bytes: f64) -> Outlook {
        let (held, peak) = (memory_bytes(), peak_memory_bytes());
        Outlook { held, peak, rows: row_bytes as u64, ..Outlook::default() }
    }

    /// Of a process that makes a split mesh of so many corners and vertices.
    pub(crate) fn of_mesh(corners: usize, vertices: usize) -> Outlook {
        let rest = corners as f64 * (CORNER + CORNER_OF_VERTEX) + vertices as f64 * SUMMED_VERTEX;
        Outlook { rest: rest as u64, ..Outlook::of_rows(0.0) }
    }

    /// As it will be when the process holds so many bytes more.
    pub(crate) fn after(self, more: f64) -> Outlook {
        let held = self.held + more as u64;
        Outlook { held, peak: self.peak.max(held), reused: (LEFT + LEFT_SHARE * held as f64) as u64, ..self }
    }

    /// What to choose so that the memory keeps within `limit`, with the rows on the disk; `None` if no voxels are large enough,
    /// or it is not up to them.
    pub fn remedy(&self, limit: Limit) -> Option<String> {
        let Voxels { size, pieces, without, alike, down_to } = self.voxels?;
        let now = pieces.at(size);
        let fits = |[most, of_pictures]: [u64; 2], count: f64| {
            let without = without + of_pictures;
            let rest = most.saturating_sub(without + alike) as f64;
            let share = count / now;
            let most = without as f64 + alike as f64 * (share / down_to).min(1.0) + rest * share;
            most <= SUGGESTED * limit.bytes as f64
        };
        let parts = self.parts(limit.pixels, true);
        pieces.coarser(size, |count| parts.into_iter().all(|part| fits(part, count)))
    }

    /// The largest memory of the process, if pictures of so many pixels are made at last; without the rows if they are
    /// `spilled`.
    pub fn most(&self, pixels: u64, spilled: bool) -> u64 {
        self.parts(pixels, spilled).map(|[most, _]| most).into_iter().fold(0, u64::max)
    }

    /// The largest memory before pictures and with them, each with what of it is for pictures.
    fn parts(&self, pixels: u64, spilled: bool) -> [[u64; 2]; 2] {
        // Few of those that are spilled are in memory at a time.
        let (rows, unpacked, shown) =
            if spilled { (0, 0, self.rows.min(WINDOWS_RESIDENT as u64)) } else { (self.rows, self.unpacked, 0) };
        let needed = rows + self.solved;
        let solving = self.held + shown + needed.saturating_sub(self.reused).max(needed / FRESH);
        let largest = solving + unpacked.max(self.corners + self.rest).max(self.later);
        let done = self.held + shown + (rows + self.lasting).saturating_sub(self.reused);
        let of_pictures = (pixels as f64 * PIXEL) as u64;
        [[self.peak.max(largest), 0], [done + of_pictures, of_pictures]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_of_what_comes_counts_and_spilled_rows_do_not() {
        let mb = 1 << 20;
        let outlook = Outlook {
            held: 100 * mb,
            peak: 120 * mb,
            rows: 50 * mb,
            unpacked: 20 * mb,
            solved: 10 * mb,
            rest: 30 * mb,
            corners: 20 * mb,
            later: 30 * mb,
            lasting: 10 * mb,
            reused: 20 * mb,
            voxels: None,
        };
        // 60 MB less 20 that are there, the corners, and 30.
        assert_eq!(outlook.most(0, false), 190 * mb);
        // What comes later may be more, or what was there before.
        assert_eq!(Outlook { later: 70 * mb, ..outlook }.most(0, false), 210 * mb);
        assert_eq!(Outlook { unpacked: 80 * mb, ..outlook }.most(0, false), 220 * mb);
        // A fifth of the 10 MB needs new memory, and so does what is seen of the file.
        assert_eq!(outlook.most(0, true), 156 * mb);
        // Nothing is below what was held already.
        let held = Outlook { peak: 210 * mb, ..outlook };
        assert_eq!(held.most(0, false), 210 * mb);
        let pictures = outlook.most(1 << 20, false);
        assert_eq!(pictures, 140 * mb + (PIXEL * (1 << 20) as f64) as u64);
    }

    #[test]
    fn an_outlook_grows_with_everything_it_counts() {
        let sizes = Sizes {
            used: 1e12,
            patches: 1000,
            row_bytes: 5e5,
            cast_bytes: 5e5,
            corners: 3000,
            vertices: 1000,
            estimate: false,
        };
        let most = |sizes: Sizes| {
            let outlook = Outlook::new(&sizes);
            (
                outlook.rows + outlook.unpacked + outlook.solved + outlook.rest + outlook.corners + outlook.later,
                outlook.lasting,
            )
        };
        let less = most(sizes);
        for more in [
            Sizes { patches: 2000, ..sizes },
            Sizes { row_bytes: 1e6, ..sizes },
            Sizes { cast_bytes: 1e6, ..sizes },
            Sizes { corners: 8000, ..sizes },
            Sizes { vertices: 3000, ..sizes },
            Sizes { estimate: true, ..sizes },
        ] {
            let more = most(more);
            assert!(more.0 > less.0 || more.1 > less.1, "{more:?} {less:?}");
        }
    }
}
