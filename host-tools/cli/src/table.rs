//! The short table that the terminal shows.

use std::fmt;

use crate::summary::{EventFacts, SpeedFacts, Summary, plural};

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.episode.words())?;
        writeln!(f, "source: {}", self.episode.source.as_deref().unwrap_or("not stated"))?;
        writeln!(f, "model:  {}, hash {}…\n", self.model.name, &self.model.hash[..12])?;
        match &self.truth {
            Some(truth) => {
                writeln!(f, "  event     onset       end   slip flag")?;
                for (i, event) in truth.events.iter().enumerate() {
                    let EventFacts { onset_s, end_s, .. } = event;
                    writeln!(f, "  {:>5}  {onset_s:>6.3} s  {end_s:>6.3} s   {}", i + 1, event.words())?;
                }
                if truth.events.is_empty() {
                    writeln!(f, "   none")?;
                }
                writeln!(f, "\n  false alarms  {}", truth.false_alarms.len())?;
                for alarm in &truth.false_alarms {
                    writeln!(f, "                at {:.3} s for {:.0} ms", alarm.start_s, alarm.duration_ms)?;
                }
                if let (Some(accuracy), Some(f1)) = (truth.accuracy, truth.macro_f1) {
                    let kind = if self.episode.synthetic { ", synthetic data" } else { "" };
                    let percent = 100.0 * accuracy;
                    writeln!(
                        f,
                        "  frames right  {percent:.1} % (macro F1 {f1:.3}, this episode only{kind})"
                    )?;
                }
            }
            None => {
                let runs = &self.output.flag_runs;
                writeln!(
                    f,
                    "  no labels, so no delays; slip flag raised {} time{}",
                    runs.len(),
                    plural(runs.len() as i64)
                )?;
                for run in runs {
                    writeln!(f, "    at {:>7.3} s for {:>6.1} ms", run.start_s, run.duration_ms)?;
                }
            }
        }
        writeln!(f, "  alarm         {}", self.alarm_words())?;
        for count in &self.output.health_frames {
            writeln!(f, "  health        {} in {} frames", count.what, count.frames)?;
        }
        let SpeedFacts { frames_per_s, times_real_time } = self.speed;
        writeln!(f, "  speed         {frames_per_s:.0} frames/s on one core, {times_real_time:.0}× real time")
    }
}
