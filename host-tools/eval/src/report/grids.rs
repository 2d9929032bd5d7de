//! The tables that terminal and report share.

use maud::{Markup, html};

use crate::grid::Grid;

/// One of them as HTML.
pub(super) fn grid(grid: &Grid) -> Markup {
    let words = |column: usize| column > 0 && column < grid.word_columns;
    html! {
        div.wide { table {
            caption { (grid.title) }
            thead { tr { @for (i, head) in grid.header.iter().enumerate() { th.text[words(i)] { (head) } } } }
            tbody { @for row in &grid.rows { tr {
                @for (i, cell) in row.iter().enumerate() { td.text[words(i)] { (cell) } }
            } } }
        } }
        @if !grid.note.is_empty() { p { small { (grid.note) } } }
    }
}
