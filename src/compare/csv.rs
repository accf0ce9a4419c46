//! CSV files: a line of column names, then numbers.

use std::{fs, path::Path};

use super::table::{Table, of_columns};
use crate::{Error, Result};

/// Reads a file such as `luxel points` and `luxel reference` write.
pub fn read(path: &Path) -> Result<Table> {
    let text = fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Table> {
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let names: Vec<String> = lines
        .next()
        .map(|(_, line)| line.split(',').map(|name| name.trim().trim_matches('"').to_string()).collect())
        .unwrap_or_default();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    for (i, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let place = || format!("line {}", i + 1);
        let mut count = 0;
        for (k, field) in line.split(',').enumerate() {
            let value: f64 = (field.trim().parse())
                .map_err(|_| Error::input(path, place(), format!("{:?} is not a number", field.trim())))?;
            if let Some(column) = columns.get_mut(k) {
                column.push(value);
            }
            count += 1;
        }
        if count != names.len() {
            let message = format!("{count} fields, but the first line names {} columns", names.len());
            return Err(Error::input(path, place(), message));
        }
    }
    if columns.first().is_none_or(Vec::is_empty) {
        return Err(Error::input(
            path,
            "",
            "holds no values; a line of column names and lines of numbers were expected",
        ));
    }
    of_columns(path, &names, |k| columns[k].clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<Table, String> {
        parse(Path::new("a.csv"), text).map_err(|e| e.to_string())
    }

    #[test]
    fn columns_are_found_by_their_names_in_any_order() {
        let table =
            read("indirect_b,x,y,z,direct_r,direct_g,direct_b,indirect_r,indirect_g,note\n6,7,8,9,1,2,3,4,5,0\n");
        let table = table.unwrap();
        let names: Vec<&str> = table.layers.iter().map(|l| l.name.as_str()).collect();
        assert_eq!(names, ["direct", "indirect", "total"]);
        assert_eq!(table.layers[1].bands, [vec![4.0], vec![5.0], vec![6.0]]);
        assert_eq!(table.layers[2].bands, [vec![5.0], vec![7.0], vec![9.0]]);
        assert_eq!(table.positions, Some(vec![[7.0, 8.0, 9.0]]));
        assert!(table.layers[2].errors.is_none());
    }

    #[test]
    fn standard_errors_have_long_names_or_short_ones() {
        let short = read("direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b,sd_r,sd_g,sd_b,si_r,si_g,si_b\n1,1,1,1,1,1,3,3,3,4,4,4").unwrap();
        let [r, .., luminance] = short.layers[2].errors.clone().unwrap();
        assert_eq!(r, [5.0]);
        let least = 5.0 * (0.2126_f64.powi(2) + 0.7152_f64.powi(2) + 0.0722_f64.powi(2)).sqrt();
        assert!((luminance[0] - least).abs() < 1e-14);
        let long =
            read("direct_r,direct_g,direct_b,direct_r_se,direct_g_se,direct_b_se,direct_luminance_se\n1,1,1,2,3,4,2.5");
        assert_eq!(long.unwrap().layers[0].errors, Some([vec![2.0], vec![3.0], vec![4.0], vec![2.5]]));
    }

    #[test]
    fn wrong_files_are_refused_with_the_place() {
        assert_eq!(read("a,b\n1\n").unwrap_err(), "a.csv: line 2: 1 fields, but the first line names 2 columns");
        assert_eq!(read("direct_r\nx\n").unwrap_err(), "a.csv: line 2: \"x\" is not a number");
        assert!(read("direct_r\n").unwrap_err().starts_with("a.csv: holds no values"));
        assert!(read("").unwrap_err().starts_with("a.csv: holds no values"));
        assert!(read("a\n1\n").unwrap_err().starts_with("a.csv: no light: columns direct_r"));
    }
}
