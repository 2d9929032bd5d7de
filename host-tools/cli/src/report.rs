//! The report: one HTML file with picture, tables and explanations, nothing loaded from elsewhere.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::picture::CLASS_NAME;
use crate::summary::{FlagScores, FrameRun, Summary, TruthInfo};

const STYLE: &str = include_str!("report.css");

/// The page; `timeline` is the picture as SVG text.
pub fn html(summary: &Summary, timeline: &str) -> String {
    let detections = match &summary.truth {
        Some(truth) => events(&truth.may_begin),
        None => html! { p {
            "The episode has no labels, so there are no delays. Slip was said to begin "
            strong { (summary.output.may_begin_runs.len()) } " times" (runs(&summary.output.may_begin_runs))
        } },
    };
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "SlipSense report" }
                style { (PreEscaped(STYLE)) }
            }
            body { main {
                h1 { "SlipSense report" }
                p { (summary.episode.words()) }
                p.origin { (origin(summary)) }
                div.picture { (PreEscaped(timeline)) }
                h2 { "Slip events" }
                (detections)
                p {
                    "A slip event is a stretch of frames labelled slip: the crosshead has moved more than 0.07 mm. "
                    "The first flag between 50 ms before the onset and the end of the event belongs to it; before the "
                    "onset it is early, which is neither a detection of delay 0 nor a false alarm. A false alarm is a "
                    "flag more than 50 ms away from every event; flags less than 200 ms apart are one alarm. Delays "
                    "count frames of 4.17 ms and hold no computing time."
                }
                @if let Some(truth) = &summary.truth { (scores(truth)) }
                h2 { "What the picture shows" }
                (EXPLANATIONS)
                h2 { "Facts" }
                (facts(summary))
                p {
                    code { "can.log" } " is the bus traffic as candump writes it: in every frame period first the slip "
                    "message, then the raw frames of each sensor. " code { "predictions.npz" } " holds class, logits, "
                    "flag and features of every frame for " code { "numpy.load" } "; " code { "summary.json" }
                    " holds the numbers of this page."
                }
            } }
        }
    };
    page.into_string()
}

const EXPLANATIONS: PreEscaped<&str> = PreEscaped(
    "<ul>
<li><strong>Pressure</strong>: the sum of the 942 taxels of each pad. It shows closing and opening of the gripper and \
changes of the grip, but mostly not a slip.</li>
<li><strong>Vibration</strong>: the accelerometer's power in 16 mel bins, over the last 16 ms of each frame, summed over \
the three axes so that the direction of the motion does not matter. Sliding makes broadband noise, but so do the gripper's \
motor and the touch itself, which is why one sense alone is not enough.</li>
<li><strong>Network</strong>: the three logits of the quantized network, which sees both senses and their recent past.</li>
<li><strong>Decision and truth</strong>: the flags as they are sent on the bus, the class of each frame, and the label \
where there is one. No contact is decided by the pads alone: every pad's sum is below 942.</li>
<li><strong>True slip speed</strong>, where the episode holds it: what the simulator knows and the sensors do not. The \
pad's skin creeps before the whole contact slides, so this and the labels do not start at the same instant.</li>
</ul>",
);

fn origin(summary: &Summary) -> Markup {
    html! {
        @match (summary.episode.synthetic, &summary.episode.source) {
            (true, _) => {
                "This episode is " strong { "synthetic" } ": a physical model generated it. Nothing here is a claim "
                "about a real gripper."
            }
            (false, Some(source)) => { "Source of the episode, as its file states: " (source) "." }
            (false, None) => { "The episode's file does not state its source." }
        }
    }
}

fn events(flag: &FlagScores) -> Markup {
    html! {
        table {
            thead { tr { th { "Event" } th { "Onset" } th { "End" } th { "May begin" } } }
            tbody {
                @for (i, event) in flag.events.iter().enumerate() {
                    tr {
                        td { (i + 1) }
                        @for time_s in [event.onset_s, event.end_s] { td { (format!("{time_s:.3} s")) } }
                        td { (event.words()) }
                    }
                }
                @if flag.events.is_empty() { tr { td colspan="4" { "no slip in this episode" } } }
            }
        }
        p { "False alarms: " strong { (flag.false_alarms.len()) } (runs(&flag.false_alarms)) }
    }
}

fn runs(runs: &[FrameRun]) -> String {
    let one = |run: &FrameRun| format!("at {:.3} s for {:.0} ms", run.start_s, run.duration_ms);
    let all: Vec<String> = runs.iter().map(one).collect();
    if all.is_empty() { ".".to_owned() } else { format!(": {}.", all.join(", ")) }
}

fn scores(truth: &TruthInfo) -> Markup {
    let percent = |share: Option<f64>| share.map_or("–".to_owned(), |s| format!("{:.2} %", 100.0 * s));
    let f1 = truth.macro_f1.map_or("–".to_owned(), |f1| format!("{f1:.3}"));
    html! {
        h2 { "Frame by frame" }
        table {
            thead { tr { th { "truth \\ decided" } @for name in CLASS_NAME { th { (name) } } } }
            tbody {
                @for (name, row) in CLASS_NAME.iter().zip(truth.confusion) {
                    tr { td { (name) } @for count in row { td { (count) } } }
                }
            }
        }
        p {
            "Accuracy " (percent(truth.accuracy)) ", macro F1 " (f1) ". False slip decisions: "
            (percent(truth.fpr_of_non_slip)) " of the frames that do not slip, " (percent(truth.fpr_of_all))
            " of all frames. Frames of one episode are no benchmark: no contact is decided by a rule on the pressure "
            "sum that the labels share."
        }
    }
}

fn facts(summary: &Summary) -> Markup {
    let Summary { episode, model, speed, output, .. } = summary;
    let mut rows = vec![
        ("Episode", episode.name.clone()),
        ("Frames", format!("{} at 240 Hz, {} sensors", episode.frames, episode.sensors)),
        ("Model", format!("{}, hash {}", model.name, model.hash)),
        ("Slip flag", summary.slip_words()),
        (
            "Speed",
            format!(
                "{:.0} frames per second on one core of this computer, {:.0} times real time",
                speed.frames_per_s, speed.times_real_time
            ),
        ),
        ("CAN", format!("{} CAN FD frames in can.log", output.can_frames)),
    ];
    rows.extend(
        output.health_frames.iter().map(|h| ("Health", format!("{} in {} frames", h.what, h.frames))),
    );
    html! { table { @for (name, value) in rows { tr { th { (name) } td { (value) } } } } }
}
