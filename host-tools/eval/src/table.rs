//! A table made once and shown twice: in the terminal and in the report.

use std::fmt;

use comfy_table::{CellAlignment, presets};
use maud::{Markup, html};

/// A table with a title and a note, either of which may be empty. Cells are text.
#[derive(Clone, Debug, Default)]
pub(crate) struct Table {
    title: String,
    header: Vec<&'static str>,
    /// Columns from the left that are words; the others are numbers.
    word_columns: usize,
    rows: Vec<Vec<String>>,
    note: String,
}

/// Head of a column, and how a row's cell is made.
pub(crate) type Column<R> = (&'static str, fn(&R) -> String);

/// Rows that lack their columns.
pub(crate) struct Rows<R> {
    title: String,
    word_columns: usize,
    rows: Vec<R>,
}

impl<R> Rows<R> {
    pub(crate) fn columns(self, columns: &[Column<R>]) -> Table {
        let header = columns.iter().map(|(head, _)| *head).collect();
        let cells = |row: &R| columns.iter().map(|(_, cell)| cell(row)).collect();
        Table::new(self.title, self.word_columns, header, self.rows.iter().map(cells).collect())
    }
}

impl Table {
    /// Row by row, each as long as the header.
    pub(crate) fn new(
        title: impl Into<String>,
        word_columns: usize,
        header: Vec<&'static str>,
        rows: Vec<Vec<String>>,
    ) -> Self {
        Self { title: title.into(), header, word_columns, rows, note: String::new() }
    }

    pub(crate) fn rows<R>(
        title: impl Into<String>,
        word_columns: usize,
        rows: impl IntoIterator<Item = R>,
    ) -> Rows<R> {
        Rows { title: title.into(), word_columns, rows: rows.into_iter().collect() }
    }

    /// The same with a note below: what one must know to read it.
    pub(crate) fn with_note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    /// Append a row as long as the header.
    pub(crate) fn push(&mut self, row: Vec<String>) {
        self.rows.push(row);
    }

    pub(crate) fn append(&mut self, row: usize, column: usize, text: &str) {
        self.rows[row][column] += text;
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    pub(crate) fn html(&self) -> Markup {
        let words = |column: usize| column < self.word_columns;
        html! {
            div.wide { table {
                caption { (self.title) }
                thead { tr { @for (i, head) in self.header.iter().enumerate() { th.text[words(i)] { (head) } } } }
                tbody { @for row in &self.rows { tr {
                    @for (i, cell) in row.iter().enumerate() { td.text[words(i)] { (cell) } }
                } } }
            } }
            @if !self.note.is_empty() { p { small { (self.note) } } }
        }
    }
}

/// As text, without spaces at the ends of lines.
impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = comfy_table::Table::new();
        table.load_preset(presets::NOTHING).set_header(self.header.iter().copied());
        table.add_rows(self.rows.iter());
        for (i, column) in table.column_iter_mut().enumerate() {
            let words = i < self.word_columns;
            column.set_cell_alignment(if words { CellAlignment::Left } else { CellAlignment::Right });
        }
        if !self.title.is_empty() {
            writeln!(f, "{}", self.title)?;
        }
        for line in table.to_string().lines() {
            writeln!(f, " {}", line.trim_end())?;
        }
        if !self.note.is_empty() {
            writeln!(f, "  {}", self.note)?;
        }
        Ok(())
    }
}

/// A share as percent, or a dash.
pub(crate) fn percent(share: Option<f64>) -> String {
    number(share.map(|share| 100.0 * share), 2)
}

/// A number with this many decimals, or a dash.
pub(crate) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A median or percentile of latencies: infinite where it is null though there are events.
pub(crate) fn latency(value: Option<f64>, events: usize) -> String {
    match value {
        None if events > 0 => "∞".to_owned(),
        _ => number(value, 1),
    }
}

pub(crate) fn yes_or_no(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}
