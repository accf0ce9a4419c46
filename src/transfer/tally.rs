//! Counting hits by patch.

/// Counters of which few are used at a time, that can be read in order without sorting: two levels of bits tell which
/// are not zero. Counting never branches on what it reads, which would wait for memory at every ray.
#[derive(Default)]
pub struct Tally {
    counts: Vec<u32>,
    /// A bit for every counter.
    used: Vec<u64>,
    /// A bit for every word of `used`.
    words: Vec<u64>,
}

impl Tally {
    /// `len` counters at zero.
    pub fn new(len: usize) -> Tally {
        let words = len.div_ceil(64);
        Tally { counts: vec![0; len], used: vec![0; words], words: vec![0; words.div_ceil(64)] }
    }

    /// Counts one more of `i`.
    #[inline]
    pub fn add(&mut self, i: u32) {
        let i = i as usize;
        self.counts[i] += 1;
        self.used[i / 64] |= 1 << (i % 64);
        self.words[i / 4096] |= 1 << (i / 64 % 64);
    }

    /// Counter `i`, which becomes zero.
    pub fn take(&mut self, i: u32) -> u32 {
        self.used[i as usize / 64] &= !(1 << (i % 64));
        std::mem::take(&mut self.counts[i as usize])
    }

    /// Calls `entry` for every counter that is not zero, in order; all become zero.
    #[inline]
    pub fn drain(&mut self, mut entry: impl FnMut(u32, u32)) {
        for (k, words) in self.words.iter_mut().enumerate() {
            for w in bits(std::mem::take(words)) {
                let word = k * 64 + w;
                for b in bits(std::mem::take(&mut self.used[word])) {
                    let i = word * 64 + b;
                    entry(i as u32, std::mem::take(&mut self.counts[i]));
                }
            }
        }
    }
}

/// The positions of the bits that are set.
fn bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros() as usize;
        (word != 0).then(|| {
            word &= word - 1;
            bit
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_come_out_in_order_and_are_zero_after() {
        let mut tally = Tally::new(10_000);
        for i in [9_999, 3, 64, 3, 4095, 4096, 3, 70] {
            tally.add(i);
        }
        assert_eq!(tally.take(70), 1);
        let mut seen = Vec::new();
        tally.drain(|i, n| seen.push((i, n)));
        assert_eq!(seen, [(3, 3), (64, 1), (4095, 1), (4096, 1), (9_999, 1)]);
        tally.drain(|i, _| panic!("{i} is not zero"));
    }
}
