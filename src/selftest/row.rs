//! One line of the table, and what it is judged by.

use serde::Serialize;

/// How far a result lies from what is expected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// |got / expected - 1|, or the largest such of several.
    Error(f64),
    /// |got - expected| in standard errors of independent samples.
    Sigmas(f64),
}

impl Figure {
    /// The number without its kind.
    pub fn value(self) -> f64 {
        match self {
            Figure::Error(x) | Figure::Sigmas(x) => x,
        }
    }
}

/// What became of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within its bound, and better than what is published of others.
    Pass,
    /// Not so, or no number at all.
    Fail,
    /// Told for comparison; nothing is asked of it.
    Info,
}

/// One case on one ray tracer.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What was computed.
    pub case: String,
    /// By which ray tracer.
    pub backend: &'static str,
    /// What it should be; of several values the one that is furthest off.
    pub expected: f64,
    /// What it is.
    pub got: f64,
    /// How far these are apart.
    pub figure: Figure,
    /// The largest figure that passes; `None` where nothing is asked.
    pub bound: Option<f64>,
    /// The largest error that another renderer has published for this case; ours must be smaller.
    pub published: Option<f64>,
    /// Whether it passed.
    pub verdict: Verdict,
}

/// Standard errors that a result may be off: one independent result in 16,000 is further off, and stratified samples do
/// better than independent ones.
pub const SIGMAS: f64 = 4.0;

impl Row {
    /// A value whose relative error may be at most `bound`.
    pub fn error(case: impl Into<String>, got: f64, expected: f64, bound: f64) -> Row {
        Row::new(case.into(), got, expected, Figure::Error((got / expected - 1.0).abs()), Some(bound))
    }

    /// The value of several that has the largest relative error; it may be at most `bound`.
    pub fn worst(case: impl Into<String>, got: &[f64], expected: &[f64], bound: f64) -> Row {
        let error = |&(g, e): &(f64, f64)| (g / e - 1.0).abs();
        let mut pairs: Vec<(f64, f64)> = got.iter().copied().zip(expected.iter().copied()).collect();
        // What is no number is the worst of all; so are values too few.
        if got.len() != expected.len() || pairs.is_empty() {
            pairs.push((f64::NAN, f64::NAN));
        }
        pairs.sort_by(|a, b| error(a).total_cmp(&error(b)));
        let (got, expected) = pairs[pairs.len() - 1];
        Row::error(case, got, expected, bound)
    }

    /// A value with the standard error `sigma`, of which it may be [`SIGMAS`] off.
    pub fn sigmas(case: impl Into<String>, got: f64, expected: f64, sigma: f64) -> Row {
        Row::new(case.into(), got, expected, Figure::Sigmas((got - expected).abs() / sigma), Some(SIGMAS))
    }

    /// A value that is told for comparison.
    pub fn info(case: impl Into<String>, got: f64, expected: f64) -> Row {
        Row::new(case.into(), got, expected, Figure::Error((got / expected - 1.0).abs()), None)
    }

    /// Asks for an error below a `published` one besides.
    pub fn published(mut self, published: f64) -> Row {
        self.published = Some(published);
        self.verdict = judge(self.figure.value(), self.bound, self.published);
        self
    }

    /// This row or `other`, whichever has the larger figure; what is no number is largest.
    pub fn or_worse(self, other: Row) -> Row {
        if self.figure.value().total_cmp(&other.figure.value()).is_lt() { other } else { self }
    }

    fn new(case: String, got: f64, expected: f64, figure: Figure, bound: Option<f64>) -> Row {
        let verdict = judge(figure.value(), bound, None);
        Row { case, backend: "", expected, got, figure, bound, published: None, verdict }
    }
}

/// A figure passes if it is a number, at most its bound, and below what is published.
fn judge(figure: f64, bound: Option<f64>, published: Option<f64>) -> Verdict {
    match bound {
        None => Verdict::Info,
        Some(bound) if figure <= bound && published.is_none_or(|p| figure < p) => Verdict::Pass,
        Some(_) => Verdict::Fail,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_above_its_bound_fails() {
        assert_eq!(Row::error("a", 1.01, 1.0, 0.011).verdict, Verdict::Pass);
        assert_eq!(Row::error("a", 0.99, 1.0, 0.011).verdict, Verdict::Pass);
        assert_eq!(Row::error("a", 1.02, 1.0, 0.011).verdict, Verdict::Fail);
        assert_eq!(Row::error("a", 0.98, 1.0, 0.011).verdict, Verdict::Fail);
        assert_eq!(Row::sigmas("a", 0.3, 0.2, 0.026).verdict, Verdict::Pass);
        assert_eq!(Row::sigmas("a", 0.3, 0.2, 0.024).verdict, Verdict::Fail);
        assert_eq!(Row::info("a", 1.5, 1.0).verdict, Verdict::Info);
    }

    #[test]
    fn what_is_no_number_fails() {
        assert_eq!(Row::error("a", f64::NAN, 1.0, 0.1).verdict, Verdict::Fail);
        assert_eq!(Row::error("a", 0.0, 0.0, 0.1).verdict, Verdict::Fail);
        assert_eq!(Row::error("a", f64::INFINITY, 1.0, 0.1).verdict, Verdict::Fail);
        assert_eq!(Row::sigmas("a", 1.0, 1.0, 0.0).verdict, Verdict::Fail);
        assert_eq!(Row::sigmas("a", 1.0, 1.0, f64::NAN).verdict, Verdict::Fail);
        assert_eq!(Row::worst("a", &[1.0, f64::NAN, 1.0], &[1.0; 3], 0.1).verdict, Verdict::Fail);
        assert_eq!(Row::worst("a", &[], &[], 0.1).verdict, Verdict::Fail);
        assert_eq!(Row::worst("a", &[1.0], &[1.0, 2.0], 0.1).verdict, Verdict::Fail);
    }

    #[test]
    fn the_worst_of_several_is_told() {
        let row = Row::worst("a", &[1.0, 1.9, 3.03], &[1.0, 2.0, 3.0], 0.1);
        assert_eq!((row.got, row.expected, row.verdict), (1.9, 2.0, Verdict::Pass));
        assert_eq!(Row::worst("a", &[1.0, 1.9, 3.03], &[1.0, 2.0, 3.0], 0.04).verdict, Verdict::Fail);
    }

    #[test]
    fn a_published_error_must_be_beaten() {
        assert_eq!(Row::error("a", 1.01, 1.0, 0.05).published(0.02).verdict, Verdict::Pass);
        assert_eq!(Row::error("a", 1.03, 1.0, 0.05).published(0.02).verdict, Verdict::Fail);
        assert_eq!(Row::error("a", 1.03, 1.0, 0.01).published(0.04).verdict, Verdict::Fail);
    }
}
