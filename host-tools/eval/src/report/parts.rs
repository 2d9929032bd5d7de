//! The tables of the report.

use maud::{Markup, html};

use crate::metrics::frames::CLASS_NAMES;
use crate::metrics::groups::Grouping;
use crate::metrics::record::Figures;
use crate::paper::{CLASS_PERCENT, Comparison, LATENCY_BY_SPEED, WITHIN_PERCENT};
use crate::results::{DetectorResults, Results};
use crate::table::{latency, number, percent};

/// A share with its interval, percent.
fn with_interval(value: Option<f64>, interval: Option<[f64; 2]>, factor: f64, decimals: usize) -> Markup {
    let value = number(value.map(|value| factor * value), decimals);
    html! {
        (value)
        @if let Some([low, high]) = interval {
            " " small { "[" (number(Some(factor * low), decimals)) ", " (number(Some(factor * high), decimals)) "]" }
        }
    }
}

/// What was evaluated.
pub(super) fn inputs(results: &Results) -> Markup {
    html! {
        div.wide { table {
            caption { "What was evaluated: " (results.kind_of_data()) }
            thead { tr {
                th { "Input" } th { "Episodes" } th { "Frames" } th { "Hours" } th { "Labelled slips" }
                th { "Slips of the interface" } th { "No contact %" } th { "No slip %" } th { "Slip %" }
            } }
            tbody {
                @for input in &results.inputs {
                    tr {
                        td { (input.name) } td { (input.episodes) } td { (input.frames) }
                        td { (format!("{:.2}", input.duration_hours)) } td { (input.labelled_events) }
                        td { (input.interface_events.map_or("–".to_owned(), |n| n.to_string())) }
                        @for share in input.class_shares { td { (percent(Some(share))) } }
                    }
                }
                @if !results.paper.is_empty() {
                    tr {
                        td { "the paper, all its data" } td {} td {} td {} td {} td {}
                        @for percent in CLASS_PERCENT { td { (format!("{percent:.1}")) } }
                    }
                }
            }
        } }
    }
}

/// The table that stands first.
pub(super) fn headline(results: &Results) -> Markup {
    html! {
        div.wide { table {
            caption { "Detectors, input by input: " (results.kind_of_data()) ", 95 % intervals in brackets" }
            thead { tr {
                th { "Detector" } th.text { "Input" } th { "Latency, median" br; "frames" }
                th { "Within 5 frames" br; "%" } th { "Missed" br; "%" } th { "Early" br; "%" }
                th { "False alarms" br; "per hour" } th { "FPR" br; "% of non-slip" }
                th { "Accuracy" br; "%" } th { "Macro F1" br; "%" }
            } }
            tbody {
                @for detector in &results.detectors {
                    @for (i, of) in detector.inputs.iter().enumerate() {
                        @let (figures, interval) = (&of.figures, &of.intervals);
                        @let (events, frame) = (&figures.encoder_events, &figures.frame);
                        tr.first[i == 0] {
                            td { @if i == 0 { (detector.name) } } td.text { (of.input) }
                            td {
                                (latency(events.latency_median_frames, events.hits + events.missed))
                                @if let Some([low, high]) = interval.latency_median_frames {
                                    " " small { "[" (latency(low, 1)) ", " (latency(high, 1)) "]" }
                                }
                            }
                            td { (with_interval(events.within_5_frames_share, interval.within_5_frames_share, 100.0, 1)) }
                            td { (with_interval(events.miss_share, interval.miss_share, 100.0, 1)) }
                            td { (percent(events.early_share)) }
                            td { (with_interval(figures.alarms.all.alarms_per_hour, interval.alarms_per_hour, 1.0, 1)) }
                            td { (with_interval(frame.fpr_of_non_slip_share, interval.fpr_of_non_slip_share, 100.0, 2)) }
                            td { (with_interval(frame.accuracy_share, interval.accuracy_share, 100.0, 2)) }
                            td { (with_interval(frame.macro_f1, interval.macro_f1, 100.0, 2)) }
                        }
                    }
                }
            }
        } }
    }
}

/// Ours beside the paper's.
pub(super) fn paper(results: &Results) -> Markup {
    let beside = |ours: Option<f64>, points: Option<f64>, theirs: f64| {
        html! { td { (number(ours, 2)) @if let Some(points) = points { " " small { (format!("{points:+.2}")) } } } td { (format!("{theirs:.2}")) } }
    };
    html! {
        div.wide { table {
            caption { "Ours (" (results.kind_of_data()) ") beside the paper's (real grippers); differences in percentage points" }
            thead { tr {
                th { "Input" } th.text { "Detector" } th.text { "The paper's name" } th { "Latency fr" } th { "paper" }
                th { "FPR %" br; "of non-slip" } th { "FPR %" br; "of all" } th { "paper" } th { "Accuracy %" } th { "paper" }
                th { "Macro F1 %" } th { "paper" } th { "within ±6" }
            } }
            tbody { @for row in &results.paper {
                @let Comparison { paper, .. } = row;
                tr {
                    td { (paper.input) } td.text { (paper.detector) } td.text { (paper.method) ", Table " (paper.table) }
                    td { (latency(row.latency_frames, 1)) } td { (format!("{:.1}", paper.latency_frames)) }
                    td { (number(row.fpr_of_non_slip_percent, 2)) " " small { (row.fpr_difference_points.map_or(String::new(), |p| format!("{p:+.2}"))) } }
                    td { (number(row.fpr_of_all_percent, 2)) } td { (format!("{:.2}", paper.fpr_percent)) }
                    (beside(row.accuracy_percent, row.accuracy_difference_points, paper.accuracy_percent))
                    (beside(row.macro_f1_percent, row.macro_f1_difference_points, paper.macro_f1_percent))
                    td { (if row.within_6_points { "yes" } else { "no" }) }
                }
            } }
        } }
        p { small { "Latency here is the paper's as far as it is stated: the median of the frames from the onset to the first "
            "flagged frame at or after it, whether the flag was up before or not. The paper does not say of which frames its FPR is "
            "a share; an FPR of 22.98 % beside an accuracy of 79.41 % can only be of those that do not slip." } }
    }
}

/// Latency by speed beside the paper's network.
pub(super) fn paper_speeds(results: &Results) -> Markup {
    let at = |detector: &DetectorResults, mm_s: f64| {
        let speeds = detector.groupings.iter().find(|grouping| grouping.by == "speed")?;
        let value = format!("{mm_s} mm/s");
        speeds
            .groups
            .iter()
            .find(|group| group.value == value)
            .map(|group| group.figures.encoder_events.clone())
    };
    let [onset, within] = WITHIN_PERCENT;
    html! {
        div.wide { table {
            caption { "Latency by speed, frames: median, mean of the hits, longest hit; ours: " (results.kind_of_data()) ", all inputs but validation" }
            thead { tr { th { "Detector" } @for (mm_s, ..) in LATENCY_BY_SPEED { th { (mm_s) " mm/s" } } } }
            tbody {
                tr { td { "the paper's network, UMI" }
                    @for (_, events, median, mean, longest) in LATENCY_BY_SPEED {
                        td { (format!("{median:.1} / {mean:.1} / {longest:.0}")) " " small { "of " (events) } }
                    } }
                @for detector in &results.detectors { tr { td { (detector.name) }
                    @for (mm_s, ..) in LATENCY_BY_SPEED {
                        td { @if let Some(events) = at(detector, mm_s) {
                            (latency(events.latency_median_frames, events.hits + events.missed)) " / "
                            (number(events.latency_mean_of_hits_frames, 1)) " / " (number(events.latency_max_of_hits_frames, 0))
                            " " small { "of " (events.events) }
                        } @else { "–" } }
                    } } }
            }
        } }
        p { small { "Of its 167 events the paper flags " (onset) " % at the onset frame and " (within) " % within 5 frames." } }
    }
}

/// Latencies against both truths.
pub(super) fn latencies(results: &Results) -> Markup {
    html! {
        div.wide { table {
            caption { "Latency in frames of 4.17 ms and travel in mm, all inputs but validation: " (results.kind_of_data()) }
            thead { tr {
                th { "Detector" } th.text { "Truth" } th { "Events" } th { "Early" } th { "Missed" } th { "Median" } th { "76 %" }
                th { "90 %" } th { "95 %" } th { "Longest hit" } th { "Flag up at onset %" } th { "… newly %" }
                th { "Travel, median" } th { "Travel, 90 %" } th { "Travel, longest hit" }
            } }
            tbody { @for detector in &results.detectors {
                @let all = &detector.all;
                @for (i, (truth, events)) in [("encoder", &all.encoder_events), ("interface", &all.interface_events)].iter().enumerate() {
                    @let counted = events.hits + events.missed;
                    tr.first[i == 0] {
                        td { @if i == 0 { (detector.name) } } td.text { (truth) } td { (events.events) } td { (events.early) } td { (events.missed) }
                        @for value in [events.latency_median_frames, events.latency_p76_frames, events.latency_p90_frames, events.latency_p95_frames] {
                            td { (latency(value, counted)) }
                        }
                        td { (number(events.latency_max_of_hits_frames, 0)) }
                        td { (percent(events.at_onset_share)) } td { (percent(events.at_onset_with_transition_share)) }
                        td { (number(events.travel_median_mm, 2)) } td { (number(events.travel_p90_mm, 2)) } td { (number(events.travel_max_of_hits_mm, 2)) }
                    }
                }
            } }
        } }
        @if let Some(detector) = results.detectors.first() {
            p { "In " (percent(detector.all.labelled_without_interface_slip_share)) " % of the labelled events ("
                (detector.all.labelled_without_interface_slip) ") the contact as a whole never slid, or the episodes do not say; "
                "the interface truth leaves them out." }
        }
        @if !results.detectors.is_empty() { (compute(results)) }
    }
}

fn compute(results: &Results) -> Markup {
    html! {
        div.wide { table {
            caption { "Computing time of one core of this computer (loading not included); it is not in the latencies" }
            thead { tr { th { "Detector" } th { "µs per frame" } th { "median latency with it, ms" } } }
            tbody { @for detector in &results.detectors {
                @let us = detector.compute_us_per_frame;
                @let frames = detector.all.encoder_events.latency_median_frames;
                tr { td { (detector.name) } td { (number(us, 1)) }
                    td { (number(frames.zip(us).map(|(frames, us)| frames * 1000.0 / 240.0 + us / 1000.0), 2)) } }
            } }
        } }
    }
}

/// Truth against decision, shares of the truth.
pub(super) fn confusion(detector: &DetectorResults, kind: &str) -> Markup {
    let frame = &detector.all.frame;
    let words = |class: usize| CLASS_NAMES[class].replace('_', " ");
    html! {
        div.wide { table {
            caption { (detector.name) ": frames by truth (rows) and decision, " (kind) }
            thead { tr { th { "Truth" } @for class in 0..3 { th { (words(class)) } } th { "Precision %" } th { "Recall %" } th { "F1 %" } } }
            tbody { @for (class, row) in frame.confusion_frames.iter().enumerate() {
                @let sum = row.iter().sum::<u64>().max(1) as f64;
                tr {
                    th { (words(class)) }
                    @for &count in row {
                        @let share = count as f64 / sum;
                        td.heat style=(format!("background: rgb(0 114 178 / {:.2})", 0.75 * share)) { (count) " " small { (percent(Some(share))) " %" } }
                    }
                    td { (percent(frame.classes[class].precision_share)) } td { (percent(frame.classes[class].recall_share)) } td { (percent(frame.classes[class].f1)) }
                }
            } }
        } }
        p { "Slip among frames with contact: precision " (percent(frame.contact_only_slip.precision_share)) " %, recall "
            (percent(frame.contact_only_slip.recall_share)) " %, F1 " (percent(frame.contact_only_slip.f1)) " %. FPR "
            (percent(frame.fpr_of_non_slip_share)) " % of the frames that do not slip, " (percent(frame.fpr_of_all_share))
            " % of all. Without the 2 frames beside every onset and end: accuracy " (percent(frame.guard_band.accuracy_share))
            " %, macro F1 " (percent(frame.guard_band.macro_f1)) " %, FPR " (percent(frame.guard_band.fpr_of_non_slip_share)) " %." }
    }
}

/// False alarms by what else went on.
pub(super) fn alarms(detector: &DetectorResults, kind: &str) -> Markup {
    let figures = &detector.all.alarms;
    let highest = figures.by_disturbance.iter().filter_map(|c| c.rate.alarms_per_hour).fold(1e-9, f64::max);
    html! {
        div.wide { table {
            caption { (detector.name) ": false alarms by what went on, " (kind) }
            thead { tr { th { "Class" } th { "Alarms" } th { "Exposure, h" } th { "Per hour" } th { "95 % bound" } th {} } }
            tbody {
                @for class in &figures.by_disturbance {
                    @let rate = &class.rate;
                    tr {
                        td { (class.disturbance) } td { (rate.alarms) } td { (format!("{:.3}", rate.exposure_hours)) }
                        td { (number(rate.alarms_per_hour, 1)) } td { (number(rate.upper_bound_per_hour, 1)) }
                        td.bar { span style=(format!("width: {:.0}px", 120.0 * rate.alarms_per_hour.unwrap_or(0.0) / highest)) {} }
                    }
                }
                tr.first { td { "all" } td { (figures.all.alarms) } td { (format!("{:.3}", figures.all.exposure_hours)) }
                    td { (number(figures.all.alarms_per_hour, 1)) } td { (number(figures.all.upper_bound_per_hour, 1)) } td {} }
            }
        } }
        @if let Some(sliding) = figures.of_these_truly_sliding {
            p { "In " (sliding) " of the " (figures.all.alarms) " alarms the contact truly slid, though not by the label." }
        }
    }
}

/// One grouping.
pub(super) fn grouping(grouping: &Grouping, kind: &str) -> Markup {
    let f1 = |figures: &Figures| 100.0 * figures.frame.macro_f1.unwrap_or(0.0);
    html! {
        div.wide { table {
            caption { "By " (grouping.by.replace('_', " ")) ": " (kind) @if let Some(worst) = &grouping.worst { "; worst: " (worst) } }
            thead { tr {
                th { (grouping.by.replace('_', " ")) } th { "Episodes" } th { "Slips" } th { "Latency fr" } th { "90 %" } th { "≤ 5 fr %" }
                th { "Missed %" } th { "Alarms/h" } th { "FPR %" } th { "Accuracy %" } th { "Macro F1 %" } th {}
            } }
            tbody { @for group in &grouping.groups {
                @let (figures, events) = (&group.figures, &group.figures.encoder_events);
                @let counted = events.hits + events.missed;
                tr {
                    td { (group.value) } td { (figures.episodes) } td { (events.events) }
                    td { (latency(events.latency_median_frames, counted)) } td { (latency(events.latency_p90_frames, counted)) }
                    td { (percent(events.within_5_frames_share)) } td { (percent(events.miss_share)) }
                    td { (number(figures.alarms.all.alarms_per_hour, 1)) } td { (percent(figures.frame.fpr_of_non_slip_share)) }
                    td { (percent(figures.frame.accuracy_share)) } td { (percent(figures.frame.macro_f1)) }
                    td.bar { span style=(format!("width: {:.0}px", 1.2 * f1(figures))) {} }
                }
            } }
        } }
    }
}

/// The operating point that validation fixed.
pub(super) fn operating_point(detector: &DetectorResults, kind: &str) -> Markup {
    html! {
        @match &detector.operating_point {
            None => p { (detector.name) " has no operating point: " (detector.operating_point_missing_because.unwrap_or("not known")) "." },
            Some(point) => div.wide { table {
                caption { (detector.name) ": threshold " (format!("{:.4}", point.threshold_score)) ", fixed on the validation input at an FPR of at most "
                    (percent(Some(point.target_fpr_of_non_slip_share))) " %; " (kind) }
                thead { tr { th { "Input" } th { "Latency fr" } th { "≤ 5 fr %" } th { "Missed %" } th { "Alarms/h" } th { "FPR %" } th { "Macro F1 %" } } }
                tbody { @for of in &point.inputs {
                    @let events = &of.figures.encoder_events;
                    tr { td { (of.input) } td { (latency(events.latency_median_frames, events.hits + events.missed)) }
                        td { (percent(events.within_5_frames_share)) } td { (percent(events.miss_share)) }
                        td { (number(of.figures.alarms.all.alarms_per_hour, 1)) } td { (percent(of.figures.frame.fpr_of_non_slip_share)) }
                        td { (percent(of.figures.frame.macro_f1)) } }
                } }
            } },
        }
    }
}

/// Pairs that should be the same, and spreads over seeds.
pub(super) fn pairs_and_seeds(results: &Results) -> Markup {
    let spread = |of: Option<[f64; 3]>, factor: f64| match of {
        Some([low, mean, high]) => format!("{:.2} ({:.2}–{:.2})", factor * mean, factor * low, factor * high),
        None => "–".to_owned(),
    };
    html! {
        @if !results.pairs.is_empty() {
            h2 { "Integers against floating point" }
            div.wide { table {
                caption { "First minus second, all inputs but validation: " (results.kind_of_data()) }
                thead { tr { th { "First" } th.text { "Second" } th { "Same class %" } th { "Frames that differ" } th { "Macro F1, points" }
                    th { "FPR, points" } th { "Latency, frames" } th { "Alarms" } } }
                tbody { @for pair in &results.pairs { tr {
                    td { (pair.first) } td.text { (pair.second) } td { (number(pair.same_class_share.map(|s| 100.0 * s), 3)) }
                    td { (pair.different_class_frames) } td { (number(pair.macro_f1_difference.map(|s| 100.0 * s), 3)) }
                    td { (number(pair.fpr_of_non_slip_difference_share.map(|s| 100.0 * s), 3)) }
                    td { (number(pair.latency_median_difference_frames, 1)) } td { (format!("{:+}", pair.alarms_difference)) }
                } } }
            } }
        }
        @if !results.seeds.is_empty() {
            h2 { "Seeds" }
            div.wide { table {
                caption { "Mean over training seeds, lowest and highest in brackets: " (results.kind_of_data()) }
                thead { tr { th { "Detector" } th.text { "Input" } th { "Seeds" } th { "Latency fr" } th { "FPR %" } th { "Accuracy %" } th { "Macro F1 %" } th { "Alarms/h" } } }
                tbody { @for of in &results.seeds { tr {
                    td { (of.family) } td.text { (of.input) } td { (of.seeds) } td { (spread(of.latency_median_frames, 1.0)) }
                    td { (spread(of.fpr_of_non_slip_share, 100.0)) } td { (spread(of.accuracy_share, 100.0)) }
                    td { (spread(of.macro_f1, 100.0)) } td { (spread(of.alarms_per_hour, 1.0)) }
                } } }
            } }
        }
    }
}
