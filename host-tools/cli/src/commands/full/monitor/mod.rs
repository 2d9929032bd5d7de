//! `slipsense monitor`: the messages of modules, in the terminal.

mod modules;
mod screen;

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use slipsense_recording::link::Place;

use super::live::{DataRate, Event, Live};
use super::print;
use modules::Modules;

/// Watch a bus in the terminal: pressure maps, logits, slip flag, health, losses
///
/// `--plain` prints a line for every second and module instead, for pipes and logs, and shows a recording as fast
/// as it can be read; the terminal view shows it in its own time.
#[derive(clap::Args)]
#[command(after_help = "\
Keys: q quits, p pauses.

Examples:
  slipsense monitor socketcan:can0
  slipsense monitor slcan:192.168.4.1:3333
  slipsense monitor grasp.mcap
  candump -L can0 | slipsense monitor - --plain
  slipsense monitor can.log --plain --json | jq -c '{s: .time_s, n: .lost}'")]
pub struct Args {
    /// Where frames come from: socketcan:can0, slcan:/dev/ttyACM0, slcan:HOST:PORT, a recording, - for standard input
    #[arg(value_name = "SOURCE")]
    source: Place,
    /// A line for every second and module, no screen
    #[arg(long)]
    plain: bool,
    /// With --plain: the lines as JSON
    #[arg(long, requires = "plain")]
    json: bool,
    #[command(flatten)]
    data: DataRate,
}

const PICTURE: Duration = Duration::from_millis(33);
const SECOND_US: u64 = 1_000_000;

impl Args {
    pub fn run(self) -> Result<()> {
        ensure!(
            self.plain || std::io::stdout().is_terminal(),
            "standard output is not a terminal: --plain prints a line every second"
        );
        let live = Live::start(&self.source, self.data.data_mbit)?;
        let watched = if self.plain { self.lines(&live) } else { self.screen(&live) };
        // Standard output has lines of JSON.
        live.passed_over().notes.iter().for_each(|note| eprintln!("note: {note}"));
        watched
    }

    fn lines(&self, live: &Live) -> Result<()> {
        let mut modules = Modules::default();
        let mut second: Option<u64> = None;
        loop {
            match live.next()? {
                Event::Frame(entry) => {
                    // By the recording's clock, which on a live bus is the wall clock.
                    let now = entry.timestamp_us / SECOND_US;
                    if second.replace(now).is_some_and(|second| now != second) {
                        self.print(&mut modules)?;
                    }
                    modules.accept(&entry);
                }
                Event::Quiet => {}
                Event::End => break,
            }
        }
        ensure!(second.is_some(), "no CAN FD frame with a 29-bit identifier arrived");
        self.print(&mut modules)
    }

    fn print(&self, modules: &mut Modules) -> Result<()> {
        for line in modules.lines() {
            let text = if self.json { serde_json::to_string(&line)? } else { line.to_string() };
            print(&(text + "\n"))?;
        }
        Ok(())
    }

    fn screen(&self, live: &Live) -> Result<()> {
        let mut screen = screen::Screen::open()?;
        let mut modules = Modules::default();
        let (mut began, mut first_us) = (Instant::now(), None);
        let (mut drawn, mut ended) = (None::<Instant>, false);
        loop {
            let event = if ended { Event::Quiet } else { live.next()? };
            match event {
                Event::Frame(entry) => {
                    let first_us = *first_us.get_or_insert(entry.timestamp_us);
                    if !self.source.is_live() && self.source != Place::Standard {
                        let due = Duration::from_micros(entry.timestamp_us.saturating_sub(first_us));
                        std::thread::sleep(due.saturating_sub(began.elapsed()));
                    }
                    modules.accept(&entry);
                }
                // The last picture of a recording stays until the user leaves.
                Event::End => ended = true,
                Event::Quiet if ended => std::thread::sleep(PICTURE),
                Event::Quiet => {}
            }
            if drawn.is_none_or(|drawn| drawn.elapsed() >= PICTURE) {
                drawn = Some(Instant::now());
                let held = Instant::now();
                if !screen.draw(&modules, ended)? {
                    return Ok(());
                }
                // Time spent paused is not time of the recording.
                began += held.elapsed();
            }
        }
    }
}
