//! All tables of the terminal and the report.

use std::fmt;

use slipsense::params::FRAME_RATE_HZ;

use crate::metrics::alarms::{AlarmFigures, Rate};
use crate::metrics::bootstrap::InputFigures;
use crate::metrics::events::{EventFigures, WITHIN_FRAMES};
use crate::metrics::figures::Figures;
use crate::metrics::frames::CLASS_NAMES;
use crate::metrics::groups::{Group, Grouping};
use crate::metrics::statistics::share;
use crate::paper::{CLASS_PERCENT, LATENCY_BY_SPEED, VALIDATION};
use crate::quantization::{FPR_POINTS, MACRO_F1_POINTS};
use crate::results::{DetectorResults, InputInfo, OperatingPoint, Results};
use crate::table::{Table, latency, number, percent, yes_or_no};

/// The median latency, infinite where half of hits and misses or more are missed.
pub(super) fn median_latency(events: &EventFigures) -> String {
    latency(events.latency_median_frames, events.hits + events.missed)
}

pub(super) fn inputs(results: &Results) -> Table {
    let mut table = Table::rows(results.kind_of_data(), 2, &results.inputs).columns(&[
        ("input", |input| input.name.clone()),
        ("episodes", |input| input.episodes.to_string()),
        ("hours", |input| format!("{:.2}", input.duration_hours)),
        ("slips", |input| input.labelled_events.to_string()),
        ("no contact %", |input| percent(Some(input.class_shares[0]))),
        ("no slip %", |input| percent(Some(input.class_shares[1]))),
        ("slip %", |input| percent(Some(input.class_shares[2]))),
    ]);
    if !results.paper.is_empty() {
        let dashes = ["–"; 3].map(str::to_owned);
        let shares = CLASS_PERCENT.map(|percent| format!("{percent:.2}"));
        table.push([["paper, all data".to_owned()].as_slice(), &dashes, &shares].concat());
    }
    table
}

/// The figures that most tables show, with the factor and decimals that they are shown with.
type Measure = (&'static str, fn(&Figures) -> Option<f64>, f64, usize);
const MEASURES: [Measure; 8] = [
    ("≤5 fr %", |f| f.encoder_events.within_5_frames_share, 100.0, 2),
    ("missed %", |f| f.encoder_events.miss_share, 100.0, 2),
    ("early %", |f| f.encoder_events.early_share, 100.0, 2),
    ("FPR %", |f| f.frame.fpr_of_non_slip_share, 100.0, 2),
    ("acc %", |f| f.frame.accuracy_share, 100.0, 2),
    ("F1 %", |f| f.frame.macro_f1, 100.0, 2),
    ("alarms/h", |f| f.alarms.all.alarms_per_hour, 1.0, 1),
    ("< /h", |f| f.alarms.all.upper_bound_per_hour, 1.0, 1),
];

/// A table of [`MEASURES`]: each row is some cells, the first `word_columns` of which are words, and figures.
fn figures_table<'a>(
    title: String,
    word_columns: usize,
    heads: &[&'static str],
    rows: impl Iterator<Item = (Vec<String>, &'a Figures)>,
) -> Table {
    let heads = heads.iter().copied().chain(["latency fr"]).chain(MEASURES.map(|(head, ..)| head));
    let cells = rows.map(|(words, figures)| {
        let cell =
            |(_, value, factor, decimals): Measure| number(value(figures).map(|v| factor * v), decimals);
        words.into_iter().chain([median_latency(&figures.encoder_events)]).chain(MEASURES.map(cell)).collect()
    });
    Table::new(title, word_columns, heads.collect(), cells.collect())
}

fn on_inputs(results: &Results) -> impl Iterator<Item = OnInput<'_>> {
    results.detectors.iter().flat_map(|detector| detector.inputs.iter().map(move |on| (detector, on)))
}

type OnInput<'a> = (&'a DetectorResults, &'a InputFigures);

fn overview(results: &Results, title: String) -> Table {
    let rows =
        on_inputs(results).map(|(detector, on)| (vec![detector.name.clone(), on.input.clone()], &on.figures));
    figures_table(title, 2, &["detector", "input"], rows).with_note(format!(
        "{}; latency: median over events, misses infinite, early ones apart; FPR: of the frames that do not slip; \
         < /h: 95 % bound",
        results.kind_of_data()
    ))
}

/// The detectors side by side with 95 % intervals.
pub(super) fn headline(results: &Results) -> Table {
    let mut table = overview(results, "Detectors, input by input, 95 % intervals in brackets".to_owned());
    for (row, (_, on)) in on_inputs(results).enumerate() {
        let of = &on.intervals;
        let latency = of.latency_median_frames.map(|bounds| bounds.map(|bound| latency(bound, 1)));
        let shown = |bounds: Option<[f64; 2]>, factor: f64, decimals: usize| {
            bounds.map(|bounds| bounds.map(|bound| number(Some(factor * bound), decimals)))
        };
        for (column, bounds) in [
            (2, latency),
            (3, shown(of.within_5_frames_share, 100.0, 1)),
            (4, shown(of.miss_share, 100.0, 1)),
            (6, shown(of.fpr_of_non_slip_share, 100.0, 2)),
            (7, shown(of.accuracy_share, 100.0, 2)),
            (8, shown(of.macro_f1, 100.0, 2)),
            (9, shown(of.alarms_per_hour, 1.0, 1)),
        ] {
            if let Some([low, high]) = bounds {
                table.append(row, column, &format!(" [{low}, {high}]"));
            }
        }
    }
    table
}

/// False alarms on an input without slip by their cause, and beside them what the same detector misses of the
/// slips of the other inputs.
fn causes(results: &Results, quiet: &InputInfo) -> Table {
    let kind = if quiet.synthetic { "synthetic data" } else { "data" };
    let title = format!("false alarms without slip ({}, {kind}) by what caused them", quiet.name);
    let mut rows = Vec::new();
    for (detector, on) in on_inputs(results).filter(|(_, on)| on.input == quiet.name) {
        let others = detector.inputs.iter().filter(|on| on.input != quiet.name && on.input != VALIDATION);
        let (missed, events) = others
            .map(|on| &on.figures.encoder_events)
            .fold((0, 0), |(missed, events), on| (missed + on.missed, events + on.events));
        let missed = percent(share(missed, events));
        rows.extend(rates(&on.figures.alarms).enumerate().map(|(i, (cause, rate))| {
            (&detector.name, cause, rate, if i == 0 { missed.clone() } else { String::new() })
        }));
    }
    Table::rows(title, 2, rows)
        .columns(&[
            ("detector", |(detector, ..)| (*detector).clone()),
            ("cause", |(_, cause, ..)| (*cause).to_owned()),
            ("alarms", |(_, _, rate, _)| rate.alarms.to_string()),
            ("hours", |(_, _, rate, _)| format!("{:.3}", rate.exposure_hours)),
            ("/h", |(_, _, rate, _)| number(rate.alarms_per_hour, 2)),
            ("< /h", |(_, _, rate, _)| number(rate.upper_bound_per_hour, 2)),
            ("missed %", |(.., missed)| missed.clone()),
        ])
        .with_note("hours: time with that cause; < /h: 95 % bound; missed: of the slips of the other inputs")
}

fn rates(alarms: &AlarmFigures) -> impl Iterator<Item = (&'static str, &Rate)> {
    let causes = alarms.by_disturbance.iter().map(|class| (class.disturbance, &class.rate));
    std::iter::once(("all", &alarms.all)).chain(causes)
}

pub(super) fn paper(results: &Results) -> Table {
    fn beside(ours: Option<f64>, points: Option<f64>) -> String {
        let ours = number(ours, 1);
        points.map_or(ours.clone(), |points| format!("{ours} ({points:+.1})"))
    }
    let title = format!("ours ({}) beside the paper's (real grippers)", results.kind_of_data());
    Table::rows(title, 2, &results.paper).columns(&[
        ("input", |row| row.paper.input.to_owned()),
        ("detector", |row| row.paper.detector.to_owned()),
        ("latency fr", |row| latency(row.latency_frames, 1)),
        ("paper", |row| format!("{:.1}", row.paper.latency_frames)),
        ("FPR %", |row| beside(row.fpr_of_non_slip_percent, row.fpr_difference_points)),
        ("paper", |row| format!("{:.1}", row.paper.fpr_percent)),
        ("acc %", |row| beside(row.accuracy_percent, row.accuracy_difference_points)),
        ("paper", |row| format!("{:.1}", row.paper.accuracy_percent)),
        ("F1 %", |row| beside(row.macro_f1_percent, row.macro_f1_difference_points)),
        ("paper", |row| format!("{:.1}", row.paper.macro_f1_percent)),
        ("within ±6", |row| yes_or_no(row.within_6_points)),
    ])
}

/// Latency by speed beside the paper's network.
pub(super) fn paper_speeds(results: &Results) -> Table {
    let title = format!(
        "Latency by speed, frames: median from the onset on, mean and longest of those after it; ours: {}, all inputs but \
         validation",
        results.kind_of_data()
    );
    let heads = ["speed", "detector", "median", "mean", "longest", "early or ≤5 fr %", "slips"];
    let mut table = Table::new(title, 2, heads.into(), Vec::new());
    for (mm_s, events, median, mean, longest) in LATENCY_BY_SPEED {
        let speed = format!("{mm_s} mm/s");
        let paper = [format!("{median:.1}"), format!("{mean:.1}"), format!("{longest:.0}")];
        table.push(
            [
                &[speed.clone(), "the paper's, UMI".to_owned()],
                &paper[..],
                &["–".to_owned(), events.to_string()],
            ]
            .concat(),
        );
        for detector in &results.detectors {
            let speeds = detector.groupings.iter().find(|grouping| grouping.by == "speed");
            let group = speeds.and_then(|speeds| speeds.groups.iter().find(|group| group.value == speed));
            let Some(events) = group.map(|group| &group.figures.encoder_events) else { continue };
            table.push(vec![
                speed.clone(),
                detector.name.clone(),
                number(events.from_onset_median_frames, 1),
                number(events.latency_mean_of_hits_frames, 1),
                number(events.latency_max_of_hits_frames, 0),
                percent(events.early_or_within_5_frames_share),
                events.events.to_string(),
            ]);
        }
    }
    table
}

/// Where the frames falsely called slip lie, for the inputs with slips.
fn false_slip(results: &Results) -> Table {
    let has_slips =
        |name: &str| results.inputs.iter().any(|input| input.name == name && input.labelled_events > 0);
    let rows = on_inputs(results).filter(|(_, on)| has_slips(&on.input));
    let title = format!("false slip frames by where they lie ({})", results.kind_of_data());
    Table::rows(title, 2, rows)
        .columns(&[
            ("detector", |(detector, _)| detector.name.clone()),
            ("input", |(_, on)| on.input.clone()),
            ("FPR %", |(_, on)| percent(on.figures.frame.fpr_of_non_slip_share)),
            ("before slip %", |(_, on)| percent(on.figures.false_slip.fpr_before_slip_share)),
            ("after slip %", |(_, on)| percent(on.figures.false_slip.fpr_after_slip_share)),
            ("elsewhere %", |(_, on)| percent(on.figures.false_slip.fpr_elsewhere_share)),
        ])
        .with_note(
            "of the frames that do not slip; before and after: up to 50 ms from an onset or end by the label",
        )
}

fn targets(results: &Results) -> Table {
    let rows = &results.targets;
    let met = rows.iter().filter(|row| row.met).count();
    let title =
        format!("network beside its targets ({}): {met} of {} met", results.kind_of_data(), rows.len());
    let seeds = match rows.first().map_or(0, |row| row.seed_values.len()) {
        1 => "one seed".to_owned(),
        n => format!("mean ± standard deviation over {n} seeds"),
    };
    Table::rows(title, 2, rows).columns(&[
        ("input", |row| row.input.clone()),
        ("figure", |row| row.measure.to_owned()),
        ("ours", |row| {
            let deviation = row.standard_deviation.map_or(String::new(), |sd| format!(" ± {sd:.2}"));
            number(row.mean, 2) + &deviation
        }),
        ("target", |row| format!("{} {}", if row.at_least { "≥" } else { "≤" }, row.bound)),
        ("met", |row| yes_or_no(row.met)),
    ])
    .with_note(format!(
        "ours: {seeds}; events by the label, early: flagged up to 50 ms before it; within {WITHIN_FRAMES} frames and \
         at onset: of all events"
    ))
}

fn quantization(results: &Results) -> Table {
    fn points(value: Option<f64>) -> String {
        value.map_or("–".to_owned(), |points| format!("{points:+.3}"))
    }
    let title = format!("integer against float ({})", results.kind_of_data());
    Table::rows(title, 2, &results.integer_against_float).columns(&[
        ("input", |row| row.input.clone()),
        ("network", |row| row.seed.clone()),
        ("same class %", |row| number(row.same_class_share.map(|share| 100.0 * share), 3)),
        ("F1 points", |row| points(row.macro_f1_difference_points)),
        ("FPR points", |row| points(row.fpr_of_non_slip_difference_points)),
        ("latency fr", |row| latency(row.latency_integer_frames, 1)),
        ("float", |row| latency(row.latency_float_frames, 1)),
        ("met", |row| yes_or_no(row.met)),
    ])
    .with_note(format!(
        "integer less float; met: under {MACRO_F1_POINTS:.1} points of F1, under {FPR_POINTS:.1} of FPR, same median \
         latency (∞: half of the events or more are missed, or there are none)"
    ))
}

fn directions(results: &Results) -> Table {
    let rows = results.detectors.iter().flat_map(|d| d.directions.iter().map(move |of| (d, of)));
    Table::rows(format!("slips by direction ({})", results.kind_of_data()), 3, rows).columns(&[
        ("detector", |(detector, _)| detector.name.clone()),
        ("direction", |(_, row)| row.direction.name().to_owned()),
        ("input", |(_, row)| row.input.clone()),
        ("slips", |(_, row)| row.encoder_events.events.to_string()),
        ("detected %", |(_, row)| percent(row.detected_share)),
        ("missed", |(_, row)| row.encoder_events.missed.to_string()),
        ("early %", |(_, row)| percent(row.encoder_events.early_share)),
        ("latency fr", |(_, row)| median_latency(&row.encoder_events)),
        ("interface: slips", |(_, row)| row.interface_events.events.to_string()),
        ("detected %", |(_, row)| percent(row.interface_detected_share)),
        ("early %", |(_, row)| percent(row.interface_events.early_share)),
        ("latency fr", |(_, row)| median_latency(&row.interface_events)),
        ("from onset fr", |(_, row)| {
            latency(row.interface_events.from_onset_median_frames, row.interface_events.events)
        }),
    ])
    .with_note(
        "the rig's slips are labelled by its crosshead, those by hand by the interface, short jerks included: what \
         compares are the last columns, against sustained sliding of the interface",
    )
}

/// What terminal and report both show, each where there is something to show.
pub(super) fn shared(results: &Results) -> Vec<Table> {
    let tables = [false_slip(results), targets(results), quantization(results), directions(results)];
    tables.into_iter().filter(|table| !table.is_empty()).collect()
}

pub(super) fn latencies(results: &Results) -> Table {
    let kind = results.kind_of_data();
    let title = format!("Latency in frames of 4.17 ms and travel in mm, all inputs but validation: {kind}");
    let rows = results.detectors.iter().flat_map(|detector| {
        let (name, all) = (detector.name.as_str(), &detector.all);
        [(name, "encoder", &all.encoder_events), (name, "interface", &all.interface_events)]
    });
    fn percentile(value: Option<f64>, events: &EventFigures) -> String {
        latency(value, events.hits + events.missed)
    }
    Table::rows(title, 2, rows).columns(&[
        ("detector", |(name, ..)| (*name).to_owned()),
        ("truth", |(_, truth, _)| (*truth).to_owned()),
        ("events", |(.., events)| events.events.to_string()),
        ("early", |(.., events)| events.early.to_string()),
        ("missed", |(.., events)| events.missed.to_string()),
        ("median", |(.., events)| median_latency(events)),
        ("76 %", |(.., events)| percentile(events.latency_p76_frames, events)),
        ("90 %", |(.., events)| percentile(events.latency_p90_frames, events)),
        ("95 %", |(.., events)| percentile(events.latency_p95_frames, events)),
        ("longest hit", |(.., events)| number(events.latency_max_of_hits_frames, 0)),
        ("flag up at onset %", |(.., events)| percent(events.at_onset_share)),
        ("… newly %", |(.., events)| percent(events.at_onset_with_transition_share)),
        ("travel, median", |(.., events)| number(events.travel_median_mm, 2)),
        ("travel, 90 %", |(.., events)| number(events.travel_p90_mm, 2)),
        ("travel, longest hit", |(.., events)| number(events.travel_max_of_hits_mm, 2)),
    ])
}

pub(super) fn compute(results: &Results) -> Table {
    let title =
        "Computing time of one core of this computer (loading not included); it is not in the latencies";
    Table::rows(title, 1, &results.detectors).columns(&[
        ("detector", |detector| detector.name.clone()),
        ("µs per frame", |detector| number(detector.compute_us_per_frame, 1)),
        ("median latency with it, ms", |detector| {
            let frames = detector.all.encoder_events.latency_median_frames;
            let ms = frames.zip(detector.compute_us_per_frame);
            number(ms.map(|(frames, us)| frames * 1000.0 / f64::from(FRAME_RATE_HZ) + us / 1000.0), 2)
        }),
    ])
}

/// The operating point that validation fixed, input by input.
pub(super) fn operating_point(detector: &str, point: &OperatingPoint, kind: &str) -> Table {
    let title = format!(
        "{detector}: threshold {:.4}, fixed on the validation input at an FPR of at most {} %; {kind}",
        point.threshold_score,
        percent(Some(point.target_fpr_of_non_slip_share))
    );
    figures_table(title, 1, &["input"], point.inputs.iter().map(|on| (vec![on.input.clone()], &on.figures)))
}

pub(super) fn seeds(results: &Results) -> Table {
    fn spread(values: Option<[f64; 3]>, factor: f64) -> String {
        values
            .map(|values| values.map(|value| factor * value))
            .map_or("–".to_owned(), |[low, mean, high]| format!("{mean:.2} ({low:.2}–{high:.2})"))
    }
    let title =
        format!("Mean over training seeds, lowest and highest in brackets: {}", results.kind_of_data());
    Table::rows(title, 2, &results.seeds).columns(&[
        ("detector", |of| of.family.clone()),
        ("input", |of| of.input.clone()),
        ("seeds", |of| of.seeds.to_string()),
        ("latency fr", |of| spread(of.latency_median_frames, 1.0)),
        ("FPR %", |of| spread(of.fpr_of_non_slip_share, 100.0)),
        ("acc %", |of| spread(of.accuracy_share, 100.0)),
        ("F1 %", |of| spread(of.macro_f1, 100.0)),
        ("alarms/h", |of| spread(of.alarms_per_hour, 1.0)),
    ])
}

/// Truth against prediction, with shares of the truth.
pub(super) fn confusion(detector: &DetectorResults, kind: &str) -> Table {
    fn count(row: &(usize, &DetectorResults), class: usize) -> String {
        let counts = row.1.all.frame.confusion_frames[row.0];
        let share = counts[class] as f64 / counts.iter().sum::<u64>().max(1) as f64;
        format!("{} ({} %)", counts[class], percent(Some(share)))
    }
    let title = format!("{}: frames by truth (rows) and prediction, {kind}", detector.name);
    Table::rows(title, 1, (0..CLASS_NAMES.len()).map(|class| (class, detector))).columns(&[
        ("truth", |(class, _)| CLASS_NAMES[*class].replace('_', " ")),
        ("no contact", |row| count(row, 0)),
        ("no slip", |row| count(row, 1)),
        ("slip", |row| count(row, 2)),
        ("precision %", |(class, of)| percent(of.all.frame.classes[*class].precision_share)),
        ("recall %", |(class, of)| percent(of.all.frame.classes[*class].recall_share)),
        ("F1 %", |(class, of)| percent(of.all.frame.classes[*class].f1)),
    ])
}

/// False alarms by what else happened.
pub(super) fn alarms(detector: &DetectorResults, kind: &str) -> Table {
    let title = format!("{}: false alarms by cause, {kind}", detector.name);
    Table::rows(title, 1, rates(&detector.all.alarms)).columns(&[
        ("cause", |(cause, _)| (*cause).to_owned()),
        ("alarms", |(_, rate)| rate.alarms.to_string()),
        ("exposure, h", |(_, rate)| format!("{:.3}", rate.exposure_hours)),
        ("per hour", |(_, rate)| number(rate.alarms_per_hour, 1)),
        ("95 % bound", |(_, rate)| number(rate.upper_bound_per_hour, 1)),
    ])
}

pub(super) fn grouping(grouping: &Grouping, kind: &str) -> Table {
    let worst = grouping.worst.as_ref().map_or(String::new(), |worst| format!("; worst: {worst}"));
    let title = format!("By {}: {kind}{worst}", grouping.by.replace('_', " "));
    let rows = grouping.groups.iter().map(|Group { value, figures }| {
        let [episodes, slips] = [figures.episodes, figures.encoder_events.events].map(|n| n.to_string());
        (vec![value.clone(), episodes, slips], figures)
    });
    figures_table(title, 1, &["group", "episodes", "slips"], rows)
}

impl fmt::Display for Results {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n{}", inputs(self), overview(self, String::new()))?;
        for quiet in self.inputs.iter().filter(|input| input.labelled_events == 0 && input.frames > 0) {
            write!(f, "\n{}", causes(self, quiet))?;
        }
        if !self.paper.is_empty() {
            write!(f, "\n{}\n{}", paper(self), paper_speeds(self))?;
        }
        shared(self).iter().try_for_each(|table| write!(f, "\n{table}"))
    }
}
