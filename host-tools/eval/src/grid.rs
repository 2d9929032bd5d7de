//! A table made once and shown twice: in the terminal and in the report.

use std::fmt;

use comfy_table::{CellAlignment, Table, presets};

/// A small table with a heading and a note. Cells are text already.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// What it shows, in one line.
    pub title: String,
    /// Heads of the columns.
    pub header: Vec<&'static str>,
    /// Columns from the left that are words; the others are numbers.
    pub word_columns: usize,
    /// Row by row, each as long as the header.
    pub rows: Vec<Vec<String>>,
    /// What one must know to read it; empty where nothing.
    pub note: String,
}

/// As text: title, table, note; no space at the ends of lines.
impl fmt::Display for Grid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new();
        table.load_preset(presets::NOTHING).set_header(self.header.iter().copied());
        table.add_rows(self.rows.iter());
        for (i, column) in table.column_iter_mut().enumerate() {
            let words = i < self.word_columns;
            column.set_cell_alignment(if words { CellAlignment::Left } else { CellAlignment::Right });
        }
        writeln!(f, "{}", self.title)?;
        for line in table.to_string().lines() {
            writeln!(f, " {}", line.trim_end())?;
        }
        if !self.note.is_empty() {
            writeln!(f, "  {}", self.note)?;
        }
        Ok(())
    }
}
