//! A table of text, for the terminal and as Markdown.

use std::fmt;

/// Where the text of a column goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    Left,
    Right,
}

/// Title, columns, rows.
#[derive(Clone, Debug)]
pub struct Table {
    title: String,
    columns: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(title: String, columns: &[(&str, Align)]) -> Self {
        let columns = columns.iter().map(|&(name, align)| (name.to_owned(), align)).collect();
        Self { title, columns, rows: Vec::new() }
    }

    /// Append a row with a cell for each column.
    pub fn row(&mut self, cells: impl Into<Vec<String>>) {
        let cells = cells.into();
        assert_eq!(cells.len(), self.columns.len(), "a cell for each column");
        self.rows.push(cells);
    }

    /// As a Markdown table under its title.
    pub fn markdown(&self) -> String {
        // Names of generic functions would be taken for HTML.
        let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | ").replace('<', "\\<"));
        let mut text = format!("{}:\n\n", self.title);
        text += &line(self.columns.iter().map(|(name, _)| name.as_str()).collect());
        let rules = self.columns.iter().map(|&(_, align)| if align == Align::Left { "---" } else { "---:" });
        text += &line(rules.collect());
        text.extend(self.rows.iter().map(|row| line(row.iter().map(String::as_str).collect())));
        text
    }

    fn width(&self, column: usize) -> usize {
        let cells = self.rows.iter().map(|row| &row[column]);
        cells.chain([&self.columns[column].0]).map(|cell| cell.chars().count()).max().unwrap_or(0)
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.title)?;
        let names: Vec<String> = self.columns.iter().map(|(name, _)| name.clone()).collect();
        for row in [&names].into_iter().chain(&self.rows) {
            let mut line = String::new();
            for (column, cell) in row.iter().enumerate() {
                let width = self.width(column);
                line += &match self.columns[column].1 {
                    Align::Left => format!("  {cell:<width$}"),
                    Align::Right => format!("  {cell:>width$}"),
                };
            }
            writeln!(f, "{}", line.trim_end())?;
        }
        Ok(())
    }
}

/// 1234567 as 1,234,567.
pub fn thousands(number: i64) -> String {
    let digits = number.unsigned_abs().to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| str::from_utf8(group).unwrap_or_default()).collect();
    format!("{}{}", if number < 0 { "-" } else { "" }, groups.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new("Costs".to_owned(), &[("kernel", Align::Left), ("n", Align::Right)]);
        table.row(["dense".to_owned(), "1,200".to_owned()]);
        table
    }

    #[test]
    fn numbers_are_grouped() {
        for (number, text) in [(0, "0"), (999, "999"), (1_000, "1,000"), (-1_234_567, "-1,234,567")] {
            assert_eq!(thousands(number), text);
        }
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        assert_eq!(table().to_string(), "Costs\n  kernel      n\n  dense   1,200\n");
    }

    #[test]
    fn markdown_has_a_rule_under_its_names() {
        let mut generic = Table::new("Costs".to_owned(), &[("kernel", Align::Left)]);
        generic.row(["<Pipeline>::step".to_owned()]);
        assert!(generic.markdown().ends_with("| \\<Pipeline>::step |\n"));
        assert_eq!(table().markdown(), "Costs:\n\n| kernel | n |\n| --- | ---: |\n| dense | 1,200 |\n");
    }
}
