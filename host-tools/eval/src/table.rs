//! The short tables that the terminal shows.

use std::fmt;

use comfy_table::{CellAlignment, Table, presets};

use crate::grid::Grid;
use crate::metrics::alarms::Rate;
use crate::metrics::false_slip;
use crate::metrics::statistics::share;
use crate::paper::{CLASS_PERCENT, Comparison, VALIDATION};
use crate::results::{InputFacts, InputFigures, Results};
use crate::{directions, integer_float, targets};

/// A share as percent.
pub(crate) fn percent(share: Option<f64>) -> String {
    share.map_or("–".to_owned(), |share| format!("{:.2}", 100.0 * share))
}

/// A number with this many decimals, or a dash.
pub(crate) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A median latency: infinite where it is null though there are events.
pub(crate) fn latency(value: Option<f64>, events: usize) -> String {
    match value {
        Some(frames) => format!("{frames:.1}"),
        None if events > 0 => "∞".to_owned(),
        None => "–".to_owned(),
    }
}

impl Results {
    /// "synthetic", "partly synthetic" or nothing, to stand before the word data.
    pub fn kind_of_data(&self) -> &'static str {
        match (self.synthetic, self.partly_synthetic) {
            (true, _) => "synthetic data",
            (false, true) => "partly synthetic data",
            (false, false) => "data",
        }
    }

    /// What terminal and report show alike: where false slip frames lie, the targets, integer against float, and the
    /// directions of slip, each where there is something to show.
    pub(crate) fn grids(&self) -> Vec<Grid> {
        let kind = self.kind_of_data();
        let has_slips =
            |name: &str| self.inputs.iter().any(|input| input.name == name && input.labelled_events > 0);
        let false_slip = false_slip::grid(&self.detectors, has_slips, kind);
        let targets = (!self.targets.is_empty()).then(|| targets::grid(&self.targets, kind));
        let rows = &self.integer_against_float;
        let integers = (!rows.is_empty()).then(|| integer_float::grid(rows, kind));
        [false_slip, targets, integers, directions::grid(&self.detectors, kind)]
            .into_iter()
            .flatten()
            .collect()
    }
}

impl Results {
    /// False alarms on an input without slip by what caused them, and beside them what the same detector
    /// misses of the slips of the other inputs.
    fn causes(&self, quiet: &InputFacts) -> String {
        let mut shown = table(&["detector", "cause", "alarms", "hours", "/h", "< /h", "missed %"]);
        for detector in &self.detectors {
            let events = || {
                let others =
                    detector.inputs.iter().filter(|of| of.input != quiet.name && of.input != VALIDATION);
                others.map(|of| &of.figures.encoder_events)
            };
            let missed: usize = events().map(|events| events.missed).sum();
            let missed = share(missed, events().map(|events| events.events).sum());
            let mut row = |cause: &str, rate: &Rate, missed: String| {
                shown.add_row([
                    detector.name.clone(),
                    cause.to_owned(),
                    rate.alarms.to_string(),
                    format!("{:.3}", rate.exposure_hours),
                    number(rate.alarms_per_hour, 2),
                    number(rate.upper_bound_per_hour, 2),
                    missed,
                ]);
            };
            for of in detector.inputs.iter().filter(|of| of.input == quiet.name) {
                row("all", &of.figures.alarms.all, percent(missed));
                for class in &of.figures.alarms.by_disturbance {
                    row(class.disturbance, &class.rate, String::new());
                }
            }
        }
        let kind = if quiet.synthetic { "synthetic data" } else { "data" };
        format!(
            "false alarms without slip ({}, {kind}) by what caused them\n{}\n  hours: time with that cause; \
             < /h: 95 % bound; missed: of the slips of the other inputs",
            quiet.name,
            finished(shown)
        )
    }
}

impl fmt::Display for Results {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut inputs =
            table(&["input", "episodes", "hours", "slips", "no contact %", "no slip %", "slip %"]);
        for input in &self.inputs {
            let [none, held, slip] = input.class_shares.map(|share| percent(Some(share)));
            let (hours, slips) = (format!("{:.2}", input.duration_hours), input.labelled_events.to_string());
            inputs.add_row([input.name.clone(), input.episodes.to_string(), hours, slips, none, held, slip]);
        }
        if !self.paper.is_empty() {
            let [none, held, slip] = CLASS_PERCENT.map(|percent| format!("{percent:.2}"));
            let dash = || "–".to_owned();
            inputs.add_row(["paper, all data".to_owned(), dash(), dash(), dash(), none, held, slip]);
        }
        let kind = self.kind_of_data();
        writeln!(f, "{kind}\n{}\n", finished(inputs))?;

        let mut main = table(&[
            "detector",
            "input",
            "latency fr",
            "≤5 fr %",
            "missed %",
            "early %",
            "FPR %",
            "acc %",
            "F1 %",
            "alarms/h",
            "< /h",
        ]);
        for detector in &self.detectors {
            for InputFigures { input, figures, .. } in &detector.inputs {
                let (events, alarms) = (&figures.encoder_events, &figures.alarms.all);
                main.add_row([
                    detector.name.clone(),
                    input.clone(),
                    latency(events.latency_median_frames, events.hits + events.missed),
                    percent(events.within_5_frames_share),
                    percent(events.miss_share),
                    percent(events.early_share),
                    percent(figures.frame.fpr_of_non_slip_share),
                    percent(figures.frame.accuracy_share),
                    percent(figures.frame.macro_f1),
                    number(alarms.alarms_per_hour, 1),
                    number(alarms.upper_bound_per_hour, 1),
                ]);
            }
        }
        writeln!(f, "{}", finished(main))?;
        writeln!(
            f,
            "  {kind}; latency: median over events, misses infinite, early ones apart; FPR: of the frames \
             that do not slip; < /h: 95 % bound"
        )?;
        for pair in &self.pairs {
            let (a, b) = (&pair.first, &pair.second);
            let same = percent(pair.same_class_share);
            let f1 = number(pair.macro_f1_difference.map(|f1| 100.0 * f1), 3);
            let latency = number(pair.latency_median_difference_frames, 1);
            let alarms = pair.alarms_difference;
            writeln!(
                f,
                "  {a} against {b}: same class in {same} % of the frames, F1 {f1} points, latency {latency} \
                 frames, alarms {alarms:+}"
            )?;
        }
        for quiet in self.inputs.iter().filter(|input| input.labelled_events == 0 && input.frames > 0) {
            writeln!(f, "\n{}", self.causes(quiet))?;
        }
        if !self.paper.is_empty() {
            writeln!(f, "\nours ({kind}) beside the paper's (real grippers)\n{}", comparison(&self.paper))?;
        }
        for grid in self.grids() {
            write!(f, "\n{grid}")?;
        }
        Ok(())
    }
}

/// Ours beside the paper's.
fn comparison(rows: &[Comparison]) -> String {
    let mut table = table(&[
        "input",
        "detector",
        "latency fr",
        "paper",
        "FPR %",
        "paper",
        "acc %",
        "paper",
        "F1 %",
        "paper",
        "within ±6",
    ]);
    for row in rows {
        let beside = |ours: Option<f64>, points: Option<f64>| match points {
            Some(points) => format!("{} ({points:+.1})", number(ours, 1)),
            None => number(ours, 1),
        };
        let paper = &row.paper;
        table.add_row([
            paper.input.to_owned(),
            paper.detector.to_owned(),
            latency(row.latency_frames, 1),
            format!("{:.1}", paper.latency_frames),
            beside(row.fpr_of_non_slip_percent, row.fpr_difference_points),
            format!("{:.1}", paper.fpr_percent),
            beside(row.accuracy_percent, row.accuracy_difference_points),
            format!("{:.1}", paper.accuracy_percent),
            beside(row.macro_f1_percent, row.macro_f1_difference_points),
            format!("{:.1}", paper.macro_f1_percent),
            if row.within_6_points { "yes" } else { "no" }.to_owned(),
        ]);
    }
    finished(table)
}

pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING).set_header(header.iter().copied());
    table
}

/// Numbers to the right, without spaces at the ends of lines.
pub(crate) fn finished(mut table: Table) -> String {
    for (i, column) in table.column_iter_mut().enumerate() {
        let text = i < 2;
        column.set_cell_alignment(if text { CellAlignment::Left } else { CellAlignment::Right });
    }
    let lines: Vec<String> = table.to_string().lines().map(|line| format!(" {}", line.trim_end())).collect();
    lines.join("\n")
}
