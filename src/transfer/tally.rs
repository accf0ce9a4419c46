//! Counting hits by patch.

use multiversion::multiversion;

use super::sorted;
use crate::simplify::hit_map::NOTHING;

/// Counters of patches and of what is none, of which few are used at a time, that can be read in order without sorting.
/// Hits that vectors can sort are not counted with them, which is faster yet.
///
/// A counter is a byte, so that those of a usual scene stay in the nearest cache. A bit tells whether it is used, and
/// marks tell which 64 and which 4096 of them are. Counting never waits for what it reads, and reading has few
/// branches on what was counted, since no processor foretells those.
#[derive(Default)]
pub struct Tally {
    /// What is no patch comes behind the patches, of which there are so many: [`NOTHING`] and above.
    patches: u32,
    counts: Vec<u8>,
    /// A bit for every counter.
    used: Vec<u8>,
    /// 1 for every 64 counters of which one is used.
    touched: Vec<u8>,
    /// 1 for every 4096 counters of which one is used.
    regions: Vec<u8>,
    /// A counter for each time that it would have passed [`FULL`].
    more: Vec<u32>,
    /// Where the used words and counters are, while they are read.
    lines: Vec<u32>,
    found: Vec<u32>,
}

const FULL: u8 = u8::MAX;

impl Tally {
    /// Counters of so many patches, at zero.
    pub fn new(patches: usize) -> Tally {
        let regions = (patches + (u32::MAX - NOTHING) as usize + 1).div_ceil(4096);
        Tally {
            patches: patches as u32,
            counts: vec![0; regions * 4096],
            used: vec![0; regions * 512],
            touched: vec![0; regions * 64],
            regions: vec![0; regions],
            ..Tally::default()
        }
    }

    /// Puts the hits of both `parts` of a row in order, as (hit, count).
    pub fn count(&mut self, parts: [&[u32]; 2], out: &mut Vec<(u32, u32)>) {
        if !sorted::count(parts, out) {
            parts.into_iter().for_each(|part| self.add(part));
            self.drain(out);
        }
    }

    fn add(&mut self, hits: &[u32]) {
        let behind = self.patches.wrapping_sub(NOTHING);
        let (counts, used, more) = (&mut self.counts[..], &mut self.used[..], &mut self.more);
        let (touched, regions) = (&mut self.touched[..], &mut self.regions[..]);
        for &hit in hits {
            let i = hit.min(hit.wrapping_add(behind));
            let at = i as usize;
            let count = &mut counts[at];
            if *count == FULL {
                more.push(i);
            } else {
                *count += 1;
            }
            used[at / 8] |= 1 << (at % 8);
            touched[at / 64] = 1;
            regions[at / 4096] = 1;
        }
    }

    /// Moves all counters that are not zero to `out`, in order.
    fn drain(&mut self, out: &mut Vec<(u32, u32)>) {
        self.lines.clear();
        let (words, _) = self.touched.as_chunks_mut::<8>();
        for (r, region) in self.regions.iter_mut().enumerate() {
            if std::mem::take(region) != 0 {
                let words = words[8 * r..8 * r + 8].iter_mut().enumerate();
                let mask = words.fold(0, |mask, (k, word)| mask | marks(std::mem::take(word)) << (8 * k));
                self.lines.extend(Bits(mask).map(|line| 64 * r as u32 + line));
            }
        }
        self.found.clear();
        read(&self.lines, &mut self.used, &mut self.found);
        self.more.sort_unstable();
        let mut more = self.more.iter().peekable();
        let counts = &mut self.counts[..];
        out.clear();
        out.extend(self.found.iter().map(|&i| {
            let mut count = std::mem::take(&mut counts[i as usize]) as u32;
            if count == FULL as u32 {
                while more.next_if(|&&m| m == i).is_some() {
                    count += 1;
                }
            }
            (i, count)
        }));
        self.more.clear();
        out.iter_mut().rev().take_while(|e| e.0 >= self.patches).for_each(|e| e.0 += NOTHING - self.patches);
    }
}

/// The positions of the bits that are set.
struct Bits(u64);

impl Iterator for Bits {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        let bit = self.0.trailing_zeros();
        (self.0 != 0).then(|| {
            self.0 &= self.0.wrapping_sub(1);
            bit
        })
    }
}

/// Gathers the lowest bits of eight bytes that are 0 or 1.
#[inline]
fn marks(bytes: [u8; 8]) -> u64 {
    u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// Appends the places of the bits of `used` in these `lines` of 64, and clears them.
///
/// How many there are is chance: four are written whether they are there or not, more need a branch (Langdale & Lemire
/// 2019).
#[multiversion(targets("x86_64+popcnt+bmi1"))]
fn read(lines: &[u32], used: &mut [u8], found: &mut Vec<u32>) {
    let (words, _) = used.as_chunks_mut::<8>();
    let mut end = 0;
    for &line in lines {
        let mut word = u64::from_le_bytes(std::mem::take(&mut words[line as usize]));
        let next = end + word.count_ones() as usize;
        if found.len() < next + 4 {
            found.resize(next + 512, 0);
        }
        while word != 0 {
            for out in &mut found[end..end + 4] {
                *out = 64 * line + word.trailing_zeros();
                word &= word.wrapping_sub(1);
            }
            end += 4;
        }
        end = next;
    }
    found.truncate(end);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drained(tally: &mut Tally) -> Vec<(u32, u32)> {
        let mut out = Vec::new();
        tally.drain(&mut out);
        out
    }

    #[test]
    fn counters_come_out_in_order_and_are_zero_after() {
        let mut tally = Tally::new(10_000);
        tally.add(&[9_999, 3, 64, 3, 4095, 4096, u32::MAX, 3, NOTHING, 70, NOTHING]);
        let counted = [(3, 3), (64, 1), (70, 1), (4095, 1), (4096, 1), (9_999, 1), (NOTHING, 2), (u32::MAX, 1)];
        assert_eq!(drained(&mut tally), counted);
        assert_eq!(drained(&mut tally), []);
    }

    #[test]
    fn every_counter_of_a_line_can_be_used() {
        let mut tally = Tally::new(300);
        tally.add(&(0..300).rev().collect::<Vec<_>>());
        assert_eq!(drained(&mut tally), (0..300).map(|i| (i, 1)).collect::<Vec<_>>());
    }

    #[test]
    fn sorted_hits_are_what_counters_tell() {
        let mut tally = Tally::new(1 << 20);
        let (mut seed, mut sorted) = (0, Vec::new());
        let mut random = |below: u32| {
            seed += 1;
            (crate::sampling::hash(&[seed]) % below as u64) as u32
        };
        // Few patches, many, and what is none.
        for len in [0, 1, 15, 16, 17, 64, 200, 255, 256] {
            for patches in [1, 2, 40, 300, 1 << 20] {
                let hits: Vec<u32> = (0..len)
                    .map(|_| match random(8) {
                        0 => [NOTHING, u32::MAX][random(2) as usize],
                        _ => random(patches),
                    })
                    .collect();
                let (first, second) = hits.split_at(random(len + 1) as usize);
                tally.add(&hits);
                let counted = drained(&mut tally);
                tally.count([first, second], &mut sorted);
                assert_eq!(sorted, counted, "{len} hits of {patches} patches");
            }
        }
    }

    #[test]
    fn zeros_and_ones_are_sorted_in_every_place() {
        // A network of exchanges that sorts these sorts all (Knuth, The Art of Computer Programming 3, 5.3.4): here those
        // of which neighbouring places differ from each other once or twice.
        let (mut tally, mut out) = (Tally::new(2), Vec::new());
        for (begin, end) in (0..256).flat_map(|begin| (begin + 1..=256).map(move |end| (begin, end))) {
            let mut hits = [1; 256];
            hits[begin..end].fill(0);
            tally.count([&hits, &[]], &mut out);
            let zeros = (end - begin) as u32;
            let counted = [(0, zeros), (1, 256 - zeros)];
            assert_eq!(out, counted[..1 + (zeros < 256) as usize]);
        }
    }

    #[test]
    fn counters_go_beyond_a_byte() {
        let counts = [(5, 254), (6, 255), (7, 256), (70, 1), (4100, 65_536)];
        let mut tally = Tally::new(5_000);
        for round in 0..65_536 {
            // In turns, the last first.
            let turn: Vec<u32> = counts.iter().rev().filter(|c| round < c.1).map(|c| c.0).collect();
            tally.add(&turn);
        }
        assert_eq!(drained(&mut tally), counts);
        assert_eq!(drained(&mut tally), []);
    }
}
