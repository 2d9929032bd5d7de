//! The terminal view.

use std::io::{Write, stdout};
use std::time::Duration;

use anyhow::Result;
use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::style::{Color, Stylize};
use crossterm::terminal::{self, Clear, ClearType};
use crossterm::{cursor, execute, queue};
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS};
use slipsense::sensor::PiezoFrame;
use slipsense_recording::{HEALTH, words};

use super::modules::{Module, Modules};
use crate::picture::CLASS_NAME;

/// Columns of a pressure map with the space beside it: one for each taxel.
const MAP_WIDTH: usize = TAXEL_COLS + 1;
/// Full scale of a logit's bar, nats.
const LOGIT_MAX: f64 = 12.0;

/// The terminal while it shows the view; restored when dropped, also after a panic.
pub struct Screen {
    paused: bool,
}

impl Screen {
    pub fn open() -> Result<Self> {
        terminal::enable_raw_mode()?;
        let screen = Self { paused: false };
        execute!(stdout(), terminal::EnterAlternateScreen, terminal::DisableLineWrap, cursor::Hide)?;
        Ok(screen)
    }

    /// Read the keyboard, and draw unless paused; `false`: the user wants to leave.
    pub fn draw(&mut self, modules: &Modules, ended: bool) -> Result<bool> {
        while event::poll(Duration::ZERO)? {
            let Event::Key(key) = event::read()? else { continue };
            let control_c = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            match key.code {
                _ if key.kind != KeyEventKind::Press => {}
                KeyCode::Char('q') | KeyCode::Esc => return Ok(false),
                _ if control_c => return Ok(false),
                KeyCode::Char('p' | ' ') => self.paused = !self.paused,
                _ => {}
            }
        }
        if !self.paused {
            let mut out = stdout().lock();
            queue!(out, terminal::BeginSynchronizedUpdate, cursor::MoveTo(0, 0))?;
            let rows = usize::from(terminal::size()?.1).saturating_sub(1);
            for line in view(modules, ended).iter().take(rows) {
                write!(out, "{line}")?;
                queue!(out, Clear(ClearType::UntilNewLine), cursor::MoveToNextLine(1))?;
            }
            execute!(out, Clear(ClearType::FromCursorDown), terminal::EndSynchronizedUpdate)?;
        }
        Ok(true)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // A terminal that is gone needs no restoring.
        let _ = execute!(stdout(), cursor::Show, terminal::EnableLineWrap, terminal::LeaveAlternateScreen);
        let _ = terminal::disable_raw_mode();
    }
}

fn view(modules: &Modules, ended: bool) -> Vec<String> {
    let state = if ended { "the recording has ended" } else { "q quits, p pauses" };
    let mut lines = vec![format!(" {:.1} s  {state}", modules.time_s()).dim().to_string()];
    if modules.modules.is_empty() {
        lines.push(" no message from a module yet".to_owned());
    }
    for (&node, module) in &modules.modules {
        let count = modules.count(node);
        lines.push(format!(
            " node {node}   {} slip messages, {} lost   {} raw, {} lost   {} errors",
            count.slip, count.slip_lost, count.raw, count.raw_lost, count.errors
        ));
        add_module(module, &mut lines);
    }
    lines
}

fn add_module(module: &Module, lines: &mut Vec<String>) {
    let Some(slip) = &module.slip else { return };
    let flag = |on: bool, name: &str| {
        let name = format!(" {name} ");
        if on { name.white().on_red().bold() } else { name.dim() }
    };
    lines.push(format!(
        "{} {} {}",
        flag(slip.slip && slip.invalid == 0, "SLIP"),
        flag(slip.may_begin, "may begin"),
        flag(slip.invalid != 0, "INVALID")
    ));
    for (class, (name, logit)) in CLASS_NAME.iter().zip(slip.logits).enumerate() {
        let logit = logit.to_f64();
        let bar = "█".repeat((logit.clamp(0.0, LOGIT_MAX) * 3.0) as usize);
        let text = format!(" {name:<11} {logit:>7.2} {bar}");
        lines.push(if usize::from(slip.class) == class { text.bold() } else { text.dim() }.to_string());
    }
    let sensors = usize::from(slip.sensors).min(slip.contact.len());
    let titles = slip.contact[..sensors].iter().enumerate().map(|(sensor, contact)| {
        let title = format!("{sensor}: {}, {}", contact.sum, words(&HEALTH, contact.health));
        format!("{title:<width$.width$} ", width = MAP_WIDTH - 1)
    });
    lines.push(titles.collect());
    for row in 0..TAXEL_ROWS / 2 {
        let maps = module.piezo[..sensors].iter().map(|piezo| match piezo {
            Some(piezo) => map_row(piezo, row) + " ",
            None => format!("{:<MAP_WIDTH$}", if row == 0 { "no taxels" } else { "" }),
        });
        lines.push(maps.collect());
    }
    lines.push(String::new());
}

/// A row of a pressure map: half blocks, two taxels above each other in one character.
fn map_row(piezo: &PiezoFrame, row: usize) -> String {
    let counts = piezo.counts();
    // At least an idle pad's noise, so that it stays dark.
    let brightest = counts.iter().copied().max().unwrap_or(0).max(64);
    let colour = |row: usize, col: usize| {
        let share = u32::from(counts[row * TAXEL_COLS + col]) * 255 / u32::from(brightest);
        let (r, g, b) = (share as u8, (share * share / 340) as u8, (60 + share / 8) as u8);
        Color::Rgb { r, g, b }
    };
    let cell = |col| "▀".with(colour(2 * row, col)).on(colour(2 * row + 1, col)).to_string();
    (0..TAXEL_COLS).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::fixed::Q;
    use slipsense::health;
    use slipsense::sensor::SensorInput;
    use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};
    use slipsense_recording::candump::LogEntry;

    #[test]
    fn a_slip_is_on_the_screen() {
        let mut modules = Modules::default();
        let mut transmitter = Transmitter::new(NodeId::DEFAULT);
        let mut message =
            SlipMessage { sensors: 1, class: 2, slip: true, may_begin: true, ..SlipMessage::default() };
        message.logits = [-512, 0, 5 * 256].map(Q::from_bits);
        message.contact[0].sum = 12_345;
        message.contact[0].health = health::XL_CLIPPED;
        let mut frames = vec![transmitter.slip(&message)];
        let mut scan = [0; 1024];
        scan[16 * 32 + 8] = 4000;
        let piezo = PiezoFrame::from_scan(scan);
        let input = SensorInput { piezo: Some(&piezo), xl: None, xl_end: 0 };
        let raw = RawFrame { timestamp_us: 0, sequence: 0, sensor: 0, health: 0, input };
        frames.extend(transmitter.raw(&raw, &mut RawBuffer::new()));
        for frame in frames {
            modules.accept(&LogEntry { timestamp_us: 0, interface: "can0".to_owned(), frame });
        }
        let lines = view(&modules, false);
        let text = lines.join("\n");
        for words in
            ["node 42", "1 slip messages, 0 lost", "SLIP", "5.00 ███", "12345", "accelerometer clipped"]
        {
            assert!(text.contains(words), "{words} is in {text}");
        }
        // Time, counts, flags, three logits and the title, then eight lines of two rows.
        let cells: Vec<&str> = lines[7 + 8].split('▀').collect();
        assert!(cells[8].contains("38;2;255;191;91"), "{}", cells[8]);
    }
}
