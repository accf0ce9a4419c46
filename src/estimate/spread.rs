//! The spread of errors whose standard deviation differs from place to place.

use rayon::prelude::*;

/// Places summed up by one thread; fixed, so that sums are the same on any number of threads.
const BLOCK: usize = 4096;

/// The size of error that 95 % of the area stays below, if the error at each place is normally distributed with the
/// `sigma` of the place.
pub fn percentile_95(sigma: &[f32], areas: &[f64]) -> f64 {
    let all: f64 = areas.iter().sum();
    let most = sigma.iter().fold(0.0, |m: f32, s| m.max(*s)) as f64;
    if !(all > 0.0 && most > 0.0 && most.is_finite()) {
        return 0.0;
    }
    // 95 % of a normal distribution are within 1.96 sigma.
    let (mut low, mut high) = (0.0, 2.0 * most);
    for _ in 0..24 {
        let x = 0.5 * (low + high);
        let below = |s: f32| if s > 0.0 { erf(x / (s as f64 * std::f64::consts::SQRT_2)) } else { 1.0 };
        let of_block =
            |(sigma, areas): (&[f32], &[f64])| sigma.iter().zip(areas).map(|(&s, a)| a * below(s)).sum::<f64>();
        let blocks: Vec<f64> = sigma.par_chunks(BLOCK).zip(areas.par_chunks(BLOCK)).map(of_block).collect();
        let share = blocks.iter().sum::<f64>() / all;
        if share < 0.95 { low = x } else { high = x }
    }
    0.5 * (low + high)
}

/// The error function for x >= 0 to 5e-4 (Abramowitz & Stegun 7.1.27).
fn erf(x: f64) -> f64 {
    let p = 1.0 + x * (0.278393 + x * (0.230389 + x * (0.000972 + x * 0.078108)));
    1.0 - p.powi(-4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_errors_have_the_percentile_of_the_normal_distribution() {
        assert!((percentile_95(&[2.0; 5], &[1.0, 2.0, 3.0, 4.0, 5.0]) / (2.0 * 1.95996) - 1.0).abs() < 0.005);
    }

    #[test]
    fn places_without_error_count_by_their_area() {
        // Half of the area has an error: of that, 90 % must lie below (1.64485 sigma).
        assert!((percentile_95(&[1.0, 0.0], &[3.0, 3.0]) / 1.64485 - 1.0).abs() < 0.005);
        assert_eq!(percentile_95(&[0.0, 0.0], &[1.0, 1.0]), 0.0);
        assert_eq!(percentile_95(&[], &[]), 0.0);
    }
}
