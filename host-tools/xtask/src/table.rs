//! Tables, written as Markdown: it reads well in a terminal too.

use std::fmt;

use comfy_table::{CellAlignment, presets};

pub struct Table {
    title: String,
    table: comfy_table::Table,
}

impl Table {
    pub fn new(title: impl Into<String>, columns: &[&str]) -> Self {
        let mut table = comfy_table::Table::new();
        table.load_preset(presets::ASCII_MARKDOWN).set_header(columns);
        // A name such as <Pipeline>::step would be taken for HTML.
        Self { title: title.into(), table }
    }

    pub fn row<T: Into<String>>(&mut self, cells: impl IntoIterator<Item = T>) {
        self.table.add_row(cells.into_iter().map(Into::into));
    }
}

impl fmt::Display for Table {
    /// Columns of numbers are aligned to the right.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = self.table.clone();
        for column in table.column_iter_mut() {
            let mut cells = self.table.column_cells_iter(column.index).flatten();
            let is_number =
                |text: String| text.trim_start_matches(['-', '+']).starts_with(|c: char| c.is_ascii_digit());
            if cells.all(|cell| cell.content().is_empty() || is_number(cell.content())) {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        writeln!(f, "\n{}:\n\n{table}", self.title)
    }
}

/// 1234567 as 1,234,567.
pub fn thousands(number: impl TryInto<i64>) -> String {
    let number = number.try_into().unwrap_or(i64::MAX);
    let digits = number.unsigned_abs().to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| str::from_utf8(group).unwrap_or_default()).collect();
    format!("{}{}", if number < 0 { "-" } else { "" }, groups.join(","))
}

/// The median, or the larger of two in the middle, and the largest; 0 of no values.
pub fn median_and_worst<T: Ord + Copy + Default>(mut values: Vec<T>) -> [T; 2] {
    values.sort_unstable();
    [values.len() / 2, values.len().saturating_sub(1)].map(|at| values.get(at).copied().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_worst_of_any_number() {
        assert_eq!(median_and_worst(vec![9, 1, 5]), [5, 9]);
        assert_eq!(median_and_worst(Vec::<u32>::new()), [0, 0]);
    }

    #[test]
    fn numbers_are_grouped() {
        for (number, text) in [(0, "0"), (999, "999"), (1_000, "1,000"), (-1_234_567, "-1,234,567")] {
            assert_eq!(thousands(number), text);
        }
    }

    #[test]
    fn columns_of_numbers_are_aligned_to_the_right() {
        let mut table = Table::new("Costs", &["kernel", "n"]);
        table.row(["dense", "1,200"]);
        table.row(["conv", "7"]);
        let expected = [
            "",
            "Costs:",
            "",
            "| kernel |     n |",
            "|--------|-------|",
            "| dense  | 1,200 |",
            "| conv   |     7 |",
        ];
        assert_eq!(table.to_string().lines().collect::<Vec<_>>(), expected);
    }
}
