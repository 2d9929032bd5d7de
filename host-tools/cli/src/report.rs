//! The report: one HTML file with picture, table and what one sees, nothing loaded from elsewhere.

use std::fmt::Write;

use crate::picture::CLASS_NAME;
use crate::summary::{FrameRun, Summary, TruthFacts};

const TEMPLATE: &str = include_str!("report.html");

/// Fill the report's template. `timeline` is the picture as SVG text.
pub fn html(summary: &Summary, timeline: &str) -> String {
    let origin = match (summary.episode.synthetic, &summary.episode.source) {
        (true, _) => "This episode is <strong>synthetic</strong>: a physical model generated it. Nothing \
                      here is a claim about a real gripper."
            .to_owned(),
        (false, Some(source)) => format!("Source of the episode, as its file states: {}.", escape(source)),
        (false, None) => "The episode's file does not state its source.".to_owned(),
    };
    let fields = [
        ("{{title}}", escape(&summary.episode.words())),
        ("{{origin}}", origin),
        ("{{picture}}", timeline.to_owned()),
        ("{{detections}}", summary.truth.as_ref().map_or_else(|| flags(summary), events)),
        ("{{scores}}", summary.truth.as_ref().map(scores).unwrap_or_default()),
        ("{{facts}}", facts(summary)),
    ];
    // In this order, and each once: what a field contains is never searched again.
    let mut html = String::with_capacity(TEMPLATE.len() + timeline.len());
    let mut rest = TEMPLATE;
    for (key, value) in &fields {
        if let Some((before, after)) = rest.split_once(key) {
            html.push_str(before);
            html.push_str(value);
            rest = after;
        }
    }
    html + rest
}

fn events(truth: &TruthFacts) -> String {
    let mut html = String::from(
        "<table><thead><tr><th>Event</th><th>Onset</th><th>End</th><th>Slip flag</th></tr></thead><tbody>",
    );
    for (i, event) in truth.events.iter().enumerate() {
        let (number, onset, end, words) = (i + 1, event.onset_s, event.end_s, event.words());
        let _ = write!(
            html,
            "<tr><td>{number}</td><td>{onset:.3} s</td><td>{end:.3} s</td><td>{words}</td></tr>"
        );
    }
    if truth.events.is_empty() {
        html += "<tr><td colspan=\"4\">no slip in this episode</td></tr>";
    }
    html += "</tbody></table>";
    let _ = write!(html, "<p>False alarms: <strong>{}</strong>{}</p>", truth.false_alarms.len(), {
        runs(&truth.false_alarms)
    });
    html
}

fn flags(summary: &Summary) -> String {
    let flag_runs = &summary.output.flag_runs;
    format!(
        "<p>The episode has no labels, so there are no delays. The slip flag was raised \
         <strong>{}</strong> times{}</p>",
        flag_runs.len(),
        runs(flag_runs)
    )
}

fn runs(runs: &[FrameRun]) -> String {
    let one = |run: &FrameRun| format!("at {:.3} s for {:.0} ms", run.start_s, run.duration_ms);
    let all: Vec<String> = runs.iter().map(one).collect();
    if all.is_empty() { ".".to_owned() } else { format!(": {}.", all.join(", ")) }
}

fn scores(truth: &TruthFacts) -> String {
    let percent = |share: Option<f64>| share.map_or("–".to_owned(), |s| format!("{:.2} %", 100.0 * s));
    let mut html = String::from("<h2>Frame by frame</h2><table><thead><tr><th>truth \\ decided</th>");
    for name in CLASS_NAME {
        let _ = write!(html, "<th>{name}</th>");
    }
    html += "</tr></thead><tbody>";
    for (name, row) in CLASS_NAME.iter().zip(truth.confusion) {
        let _ =
            write!(html, "<tr><td>{name}</td><td>{}</td><td>{}</td><td>{}</td></tr>", row[0], row[1], row[2]);
    }
    let _ = write!(
        html,
        "</tbody></table><p>Accuracy {}, macro F1 {}. False slip decisions: {} of the frames that do not \
         slip, {} of all frames. Frames of one episode are no benchmark: no contact is decided by a \
         rule on the pressure sum that the labels share.</p>",
        percent(truth.accuracy),
        truth.macro_f1.map_or("–".to_owned(), |f1| format!("{f1:.3}")),
        percent(truth.fpr_of_non_slip),
        percent(truth.fpr_of_all),
    );
    html
}

fn facts(summary: &Summary) -> String {
    let mut rows = vec![
        ("Episode", summary.episode.name.clone()),
        ("Frames", format!("{} at 240 Hz, {} sensors", summary.episode.frames, summary.episode.sensors)),
        ("Model", format!("{}, hash {}", summary.model.name, summary.model.hash)),
        ("Alarm", summary.alarm_words()),
        (
            "Speed",
            format!(
                "{:.0} frames per second on one core of this computer, {:.0} times real time",
                summary.speed.frames_per_s, summary.speed.times_real_time
            ),
        ),
        ("CAN", format!("{} CAN FD frames in can.log", summary.output.can_frames)),
    ];
    for count in &summary.output.health_frames {
        rows.push(("Health", format!("{} in {} frames", count.what, count.frames)));
    }
    let mut html = String::from("<table>");
    for (name, value) in rows {
        let _ = write!(html, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
    }
    html + "</table>"
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_has_every_field_once_in_order() {
        let fields = ["title", "origin", "picture", "detections", "scores", "facts"];
        let places: Vec<usize> = fields
            .map(|field| {
                let key = format!("{{{{{field}}}}}");
                assert_eq!(TEMPLATE.matches(&key).count(), 1, "{key}");
                TEMPLATE.find(&key).unwrap()
            })
            .to_vec();
        assert!(places.is_sorted());
    }

    #[test]
    fn text_from_a_file_cannot_become_markup() {
        assert_eq!(escape("<b a=\"&\">"), "&lt;b a=&quot;&amp;&quot;&gt;");
    }
}
