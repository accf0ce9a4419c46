//! The table as text.

use std::fmt;

use super::{Figure, Row, Selftest, Verdict};

impl fmt::Display for Selftest {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<45} {:<7} {:>12} {:>12} {:>12} {:>11} {:>9}",
            "case", "backend", "expected", "got", "off by", "at most", "Cycles"
        )?;
        for row in &self.rows {
            writeln!(f, "{row}")?;
        }
        let failed = self.failures().count();
        let asked = self.rows.iter().filter(|row| row.verdict != Verdict::Info).count();
        writeln!(
            f,
            "luxel {}, {}, {} threads: {} of {asked} pass in {:.1} s",
            self.version,
            self.tracers.join(", "),
            self.threads,
            asked - failed,
            self.seconds
        )?;
        self.failures().try_for_each(|row| writeln!(f, "FAILED: {} ({})", row.case, row.backend))
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let figure = |x: f64| match self.figure {
            Figure::Error(_) => percent(x),
            Figure::Sigmas(_) => format!("{x:.2} sigma"),
        };
        write!(
            f,
            "{:<45} {:<7} {:>12} {:>12} {:>12} {:>11} {:>9}  {}",
            self.case,
            self.backend,
            number(self.expected),
            number(self.got),
            figure(self.figure.value()),
            self.bound.map_or(String::new(), figure),
            self.published.map_or(String::new(), percent),
            match self.verdict {
                Verdict::Pass => "pass",
                Verdict::Fail => "FAIL",
                Verdict::Info => "info",
            }
        )
    }
}

/// Seven digits.
fn number(x: f64) -> String {
    // Rounded first: 0.99999999 has the digits of 1.
    let rounded = format!("{x:.6e}");
    let exponent = rounded.split_once('e').and_then(|(_, e)| e.parse::<i32>().ok()).unwrap_or(0);
    format!("{x:.0$}", (6 - exponent.clamp(-3, 6)) as usize)
}

/// Two digits, however small.
fn percent(x: f64) -> String {
    let p = 100.0 * x;
    if p == 0.0 {
        "0 %".into()
    } else if p >= 0.001 {
        format!("{p:.4} %")
    } else {
        format!("{p:.1e} %")
    }
}
