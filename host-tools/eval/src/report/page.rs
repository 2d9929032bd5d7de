//! The page: headline first, then why, definitions last.

use anyhow::Result;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use plotters::prelude::{IntoLogRange, SeriesLabelPosition};

use super::plots::{Axes, Line, plot};
use super::tables;
use super::timeline::timeline;
use crate::metrics::events::Cdf;
use crate::metrics::operating::CurvePoint;
use crate::paper::WITHIN_PERCENT;
use crate::results::{DetectorResults, Results, SpeedCdf};
use crate::run::Run;
use crate::table::percent;

const STYLE: &str = include_str!("page.css");
/// Longest latency on the plots' axes: 250 ms.
const CDF_FRAMES: f64 = 60.0;

pub fn html(results: &Results, run: &Run) -> Result<String> {
    let kind = results.kind_of_data();
    let (latency_plots, threshold_plots) = (latency_plots(results)?, threshold_plots(results)?);
    let details = results.detectors.iter().enumerate().map(|(i, of)| detail(results, run, i, of));
    let details = details.collect::<Result<Vec<_>>>()?;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "SlipSense evaluation" }
                style { (PreEscaped(STYLE)) }
            }
            body { main {
                h1 { "Slip detectors compared" }
                p.origin { (origin(results)) }
                (tables::headline(results).html())
                p { "Latency counts from the encoder's onset; missed events are infinitely late, early ones stand apart. Numbers of one "
                    "row belong to one threshold. " a href="#definitions" { "Definitions" } " are at the end; all numbers of this page, and "
                    "more, are in " code { "metrics.json" } "." }
                (tables::inputs(results).html())
                @if !results.paper.is_empty() { h2 { "Beside the paper" } (paper(results)) }
                @for (i, table) in tables::shared(results).iter().enumerate() {
                    @if i == 0 { h2 { "False slip, targets, integers, directions" } }
                    (table.html())
                }
                h2 { "How soon" }
                (latencies(results))
                (latency_plots)
                h2 { "What a threshold trades" }
                (threshold_plots)
                @for detector in &results.detectors { (operating_point(detector, kind)) }
                @if !results.seeds.is_empty() { h2 { "Seeds" } (tables::seeds(results).html()) }
                h2 { "Detector by detector" }
                @for detail in &details { (detail) }
                (definitions(results))
            } }
        }
    };
    Ok(page.into_string())
}

fn origin(results: &Results) -> Markup {
    html! {
        @if results.synthetic {
            "All of this is " strong { "synthetic" } " data: a physical model made every episode. The numbers rank detectors on that model; "
            "nothing here is a claim about a real gripper."
        } @else if results.partly_synthetic {
            "Part of the data is " strong { "synthetic" } ": made by a physical model, no claim about a real gripper."
        } @else {
            "No episode is marked as synthetic."
        }
    }
}

fn figure(svg: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(svg)) figcaption { (caption) } } }
}

fn latency_plots(results: &Results) -> Result<Markup> {
    let kind = results.kind_of_data();
    let mut plots = Vec::new();
    let mut plot = |title: &str, lines: Vec<Line>, caption: &str| -> Result<()> {
        let axes = Axes {
            title,
            x: "frames of 4.17 ms after the onset, up to",
            y: "% of hits and misses",
            legend: SeriesLabelPosition::LowerRight,
        };
        let svg = plot(&axes, 0.0..CDF_FRAMES, 0.0..100.0, &lines)?;
        plots.push(figure(&svg, &format!("{caption} ({kind})")));
        Ok(())
    };
    let lines = |cdf: fn(&DetectorResults) -> &Cdf| -> Vec<Line> {
        results.detectors.iter().map(|detector| cdf_line(&detector.name, cdf(detector))).collect()
    };
    let below = "What a line lacks of 100 % at the right is later than 250 ms or missed";
    plot("Latency, encoder truth", lines(|detector| &detector.encoder_cdf), below)?;
    plot("Latency, interface truth", lines(|detector| &detector.interface_cdf), below)?;
    if let Some(first) = results.detectors.first().filter(|first| !first.speed_cdfs.is_empty()) {
        let line = |of: &SpeedCdf| cdf_line(&format!("{} mm/s", of.speed_mm_s), &of.encoder_cdf);
        let caption = format!("{}, encoder truth, by speed of the pull", first.name);
        plot("Latency by speed", first.speed_cdfs.iter().map(line).collect(), &caption)?;
    }
    Ok(html! { div.plots { @for plot in &plots { (plot) } } })
}

fn threshold_plots(results: &Results) -> Result<Markup> {
    let curve = |title: &str, y: &str, top: f64, value: fn(&CurvePoint) -> Option<f64>| {
        let lines: Vec<Line> = results.detectors.iter().map(|d| curve_line(d, top, value)).collect();
        let rates = || lines.iter().flat_map(|line| &line.points).map(|point| point.0);
        let range = rates().fold(1.0, f64::min)..1.2 * rates().fold(10.0, f64::max);
        let legend = SeriesLabelPosition::UpperRight;
        plot(&Axes { title, x: "false alarms per hour", y, legend }, range.log_scale(), 0.0..top, &lines)
    };
    let caption = format!(
        "Ring: the detector's own threshold; disc: the point fixed on the validation input; what is slower than 250 ms \
         is not drawn ({})",
        results.kind_of_data()
    );
    let latency = curve("Latency against false alarms", "median latency, frames", CDF_FRAMES, |point| {
        point.latency_median_frames
    })?;
    let misses = curve("Misses against false alarms", "% of the events missed", 100.0, |point| {
        point.miss_share.map(|share| 100.0 * share)
    })?;
    Ok(html! { div.plots { (figure(&latency, &caption)) (figure(&misses, &caption)) } })
}

/// A staircase: the share jumps where a latency occurs.
fn cdf_line(name: &str, cdf: &Cdf) -> Line {
    let mut points = Vec::new();
    let mut level = 0.0;
    for (&frames, &share) in cdf.latency_at_most_frames.iter().zip(&cdf.events_share) {
        let frames = f64::from(frames);
        if frames > CDF_FRAMES {
            break;
        }
        points.extend([(frames, level), (frames, 100.0 * share)]);
        level = 100.0 * share;
    }
    if cdf.events > 0 {
        points.push((CDF_FRAMES, level));
    }
    Line { name: format!("{name} ({} events)", cdf.events), points, marks: Vec::new() }
}

/// Least rate on the logarithmic axis; fewer alarms are drawn there.
const LOWEST_PER_HOUR: f64 = 0.1;

/// Points with values up to `top`.
fn curve_line(detector: &DetectorResults, top: f64, value: fn(&CurvePoint) -> Option<f64>) -> Line {
    let at = |point: &CurvePoint| {
        let value = value(point).filter(|value| *value <= top)?;
        Some((point.alarms_per_hour?.max(LOWEST_PER_HOUR), value))
    };
    let marked = detector.curve.iter().filter(|p| p.is_detectors_own || p.is_operating_point);
    Line {
        name: detector.name.clone(),
        points: detector.curve.iter().filter_map(at).collect(),
        marks: marked.filter_map(|point| Some((at(point)?, point.is_operating_point))).collect(),
    }
}

fn detail(results: &Results, run: &Run, index: usize, detector: &DetectorResults) -> Result<Markup> {
    let kind = results.kind_of_data();
    let worst = match (&detector.worst_episode, detector.worst_index) {
        (Some(worst), Some(episode)) => {
            let svg = timeline(&run.truths[episode], &run.predictions[index][episode])?;
            let caption = format!(
                "Worst episode: {}/{}, {} missed, {} false alarms. Flag against label (encoder) and interface (sliding); grey: other \
                 events; the grey line under the score is the threshold ({kind})",
                worst.input, worst.name, worst.missed_events, worst.false_alarms
            );
            figure(&svg, &caption)
        }
        _ => html! { p { "No episode has a missed event or a false alarm." } },
    };
    Ok(html! {
        details open[index == 0] {
            summary { (detector.name) }
            (confusion(detector, kind))
            (alarms(detector, kind))
            @for grouping in &detector.groupings { (tables::grouping(grouping, kind).html()) }
            (worst)
        }
    })
}

fn paper(results: &Results) -> Markup {
    let [onset, within] = WITHIN_PERCENT;
    html! {
        (tables::paper(results).html())
        p { small { "Latency here is the paper's as far as it is stated: the median of the frames from the onset to the first "
            "flagged frame at or after it, whether the flag was up before or not. The paper does not say of which frames its FPR is "
            "a share; an FPR of 22.98 % beside an accuracy of 79.41 % can only be of those that do not slip." } }
        (tables::paper_speeds(results).html())
        p { small { "Of its 167 events the paper flags " (onset) " % at the onset frame and " (within) " % within 5 frames." } }
    }
}

fn latencies(results: &Results) -> Markup {
    html! {
        (tables::latencies(results).html())
        @if let Some(detector) = results.detectors.first() {
            p { "In " (percent(detector.all.labelled_without_interface_slip_share)) " % of the labelled events ("
                (detector.all.labelled_without_interface_slip) ") the contact as a whole never slid, or the episodes lack the interface truth; "
                "the interface truth leaves them out." }
            (tables::compute(results).html())
        }
    }
}

fn operating_point(detector: &DetectorResults, kind: &str) -> Markup {
    let Some(point) = &detector.operating_point else {
        let why = detector.operating_point_missing_because.unwrap_or("not known");
        return html! { p { (detector.name) " has no operating point: " (why) "." } };
    };
    tables::operating_point(&detector.name, point, kind).html()
}

fn confusion(detector: &DetectorResults, kind: &str) -> Markup {
    let frame = &detector.all.frame;
    let (contact, guard) = (&frame.contact_only_slip, &frame.guard_band);
    html! {
        (tables::confusion(detector, kind).html())
        p { "Slip among frames with contact: precision " (percent(contact.precision_share)) " %, recall "
            (percent(contact.recall_share)) " %, F1 " (percent(contact.f1)) " %. FPR "
            (percent(frame.fpr_of_non_slip_share)) " % of the frames that do not slip, " (percent(frame.fpr_of_all_share))
            " % of all. Without the 2 frames beside every onset and end: accuracy " (percent(guard.accuracy_share))
            " %, macro F1 " (percent(guard.macro_f1)) " %, FPR " (percent(guard.fpr_of_non_slip_share)) " %." }
    }
}

fn alarms(detector: &DetectorResults, kind: &str) -> Markup {
    let figures = &detector.all.alarms;
    html! {
        (tables::alarms(detector, kind).html())
        @if let Some(sliding) = figures.of_these_truly_sliding {
            p { "In " (sliding) " of the " (figures.all.alarms) " alarms the contact truly slid, though not by the label." }
        }
    }
}

fn definitions(results: &Results) -> Markup {
    html! {
        h2 #definitions { "Definitions" }
        dl {
            dt { "Encoder truth" } dd { "An event is a run of frames labelled slip: the crosshead has moved by more than 0.07 mm." }
            dt { "Interface truth" } dd { "What the generator knows: the slip speed is above 0.1 mm/s and more than 95 % of the load slips, gaps "
                "below 50 ms closed, 50 ms at least. The sliding of a labelled event is the first that begins between 250 ms before the "
                "label and its end." }
            dt { "Detection" } dd { "The first flag between 50 ms before the onset and the end of the event. Before the onset it is early: neither "
                "a latency of 0 nor a false alarm. After the end the event is missed." }
            dt { "Latency" } dd { "Frames of 4.17 ms from the onset to the detection, 0 being the onset frame. Medians, percentiles and shares "
                "are over hits and misses, misses being infinite (∞). Computing time is not in it." }
            dt { "Flag up at onset" } dd { "Share of all events whose onset frame is flagged; newly: and the frame before is not." }
            dt { "Direction" } dd { "Vertical: as the rig pulls, along the pad. By hand the label is the interface's, which includes short jerks; "
                "the interface truth is sustained sliding only." }
            dt { "Travel" } dd { "Between onset and detection: of the crosshead (encoder truth; 0.07 mm have passed at the onset), or slid by the "
                "interface (interface truth)." }
            dt { "False alarm" } dd { "A run of flags more than 50 ms away from all labelled slip; runs less than 200 ms apart are one. Rates are per "
                "hour of the time outside slip ± 50 ms. Its cause is what happened from 150 ms before its start, short impacts first. "
                "Bounds are exact one-sided 95 % bounds of a Poisson rate." }
            dt { "FPR" } dd { "Frames falsely called slip, of the frames that do not slip." }
            dt { "Macro F1" } dd { "Mean of the F1 of the three classes, of those that occur or are predicted. No contact is a rule on the pressure sum that labels and detectors may share." }
            dt { "Operating point" } dd { "The lowest threshold whose FPR on the validation input does not exceed the target, applied unchanged." }
            dt { "Intervals" } dd { "95 %, bootstrap over episodes, 1000 draws with a fixed seed; none below 5 episodes." }
            dt { "Streams" } dd { "The episodes of an input, by name, are cut into " (results.streams) " contiguous streams (fewer if there are fewer "
                "episodes). A detector keeps its state from episode to episode of a stream, as a module that is never switched off." }
        }
        p { small { "Evaluated in " (format!("{:.1}", results.wall_s)) " s on " (results.threads) " threads, loading or generating included. Layout "
            (results.schema) "." } }
    }
}
