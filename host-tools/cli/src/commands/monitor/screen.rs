//! The terminal view.

use std::time::Duration;

use anyhow::Result;
use ratatui::DefaultTerminal;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Widget};
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS};
use slipsense::sensor::PiezoFrame;

use super::seen::{Module, Seen, health_words};
use crate::picture::CLASS_NAME;

/// Two rows of taxels in a line of text, two columns of text for a taxel would be square; one is enough to see.
const MAP_WIDTH: u16 = TAXEL_COLS as u16 + 2;
const MAP_HEIGHT: u16 = TAXEL_ROWS as u16 / 2 + 2;
/// Above the maps.
const FACTS_HEIGHT: u16 = 6;
/// Full scale of a logit's bar, nats.
const LOGIT_MAX: f64 = 12.0;

/// The terminal while it shows the view; itself again afterwards, also after a panic.
pub(super) struct Screen {
    terminal: DefaultTerminal,
    held: bool,
}

impl Screen {
    pub(super) fn open() -> Result<Self> {
        Ok(Self { terminal: ratatui::try_init()?, held: false })
    }

    /// Draw, unless held, and look at the keyboard; `false`: somebody wants to leave.
    pub(super) fn draw(&mut self, seen: &Seen, ended: bool) -> Result<bool> {
        while event::poll(Duration::ZERO)? {
            let Event::Key(key) = event::read()? else { continue };
            let control_c = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            match key.code {
                _ if key.kind != KeyEventKind::Press => {}
                KeyCode::Char('q') | KeyCode::Esc => return Ok(false),
                _ if control_c => return Ok(false),
                KeyCode::Char('p' | ' ') => self.held = !self.held,
                _ => {}
            }
        }
        if !self.held {
            self.terminal.draw(|frame| view(frame, seen, ended))?;
        }
        Ok(true)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

fn view(frame: &mut Frame<'_>, seen: &Seen, ended: bool) {
    let state = if ended { "the recording has ended" } else { "q ends, p holds" };
    let [head, body] = Layout::vertical([Constraint::Length(1), Constraint::Min(0)]).areas(frame.area());
    frame.render_widget(Line::from(format!(" {:.1} s  {state}", seen.time_s())).dim(), head);
    if seen.modules.is_empty() {
        frame.render_widget(Paragraph::new(" no module heard yet"), body);
        return;
    }
    let height = Constraint::Length(FACTS_HEIGHT + MAP_HEIGHT);
    let areas = Layout::vertical(vec![height; seen.modules.len()]).split(body);
    for ((node, module), &area) in seen.modules.iter().zip(areas.iter()) {
        one(frame, *node, module, seen, area);
    }
}

fn one(frame: &mut Frame<'_>, node: u8, module: &Module, seen: &Seen, area: Rect) {
    let [facts, maps] = Layout::vertical([Constraint::Length(FACTS_HEIGHT), Constraint::Min(0)]).areas(area);
    let count = seen.count(node);
    let mut lines = vec![Line::from(format!(
        " node {node}   {} slip messages, {} lost   {} raw, {} lost   {} errors",
        count.slip, count.slip_lost, count.raw, count.raw_lost, count.errors
    ))];
    if let Some(slip) = &module.slip {
        let flag = |on: bool, name: &'static str| {
            let style = if on { Style::new().white().on_red().bold() } else { Style::new().dim() };
            Span::styled(format!(" {name} "), style)
        };
        lines.push(Line::from(vec![flag(slip.alarm, "ALARM"), " ".into(), flag(slip.slip, "slip")]));
        for (class, (name, logit)) in CLASS_NAME.iter().zip(slip.logits).enumerate() {
            let logit = logit.to_f64();
            let bar = "█".repeat((logit.clamp(0.0, LOGIT_MAX) * 3.0) as usize);
            let text = format!(" {name:<11} {logit:>7.2} {bar}");
            let text = Line::from(text);
            lines.push(if usize::from(slip.class) == class { text.bold() } else { text.dim() });
        }
    }
    frame.render_widget(Paragraph::new(lines), facts);
    let sensors = module.slip.map_or(0, |slip| slip.sensors);
    let widths = vec![Constraint::Length(MAP_WIDTH); usize::from(sensors)];
    for (sensor, &area) in Layout::horizontal(widths).split(maps).iter().enumerate() {
        let contact = module.slip.map(|slip| slip.contact[sensor]).unwrap_or_default();
        let block = Block::bordered()
            .title(format!("{sensor}: {}", contact.sum))
            .title_bottom(health_words(contact.health));
        let inner = block.inner(area);
        frame.render_widget(block, area);
        match &module.piezo[sensor] {
            Some(piezo) => frame.render_widget(Map(piezo), inner),
            None => frame.render_widget(Paragraph::new("no raw message").dim(), inner),
        }
    }
}

/// A pressure map: half blocks, two taxels over each other in one cell.
struct Map<'a>(&'a PiezoFrame);

impl Widget for Map<'_> {
    fn render(self, area: Rect, buffer: &mut Buffer) {
        let counts = self.0.counts();
        // At least an idle pad's noise, so that it stays dark.
        let brightest = counts.iter().copied().max().unwrap_or(0).max(64);
        let colour = |row: u16, col: u16| {
            let count = counts.get(usize::from(row) * TAXEL_COLS + usize::from(col)).copied().unwrap_or(0);
            let share = u32::from(count) * 255 / u32::from(brightest);
            Color::Rgb(share as u8, (share * share / 340) as u8, (60 + share / 8) as u8)
        };
        for row in 0..area.height.min(TAXEL_ROWS as u16 / 2) {
            for col in 0..area.width.min(TAXEL_COLS as u16) {
                if let Some(cell) = buffer.cell_mut((area.x + col, area.y + row)) {
                    cell.set_symbol("▀").set_fg(colour(2 * row, col)).set_bg(colour(2 * row + 1, col));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use slipsense::fixed::Logit;

    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use slipsense::health;
    use slipsense::sensor::SensorInput;
    use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};
    use slipsense_recording::candump::LogEntry;

    #[test]
    fn a_slip_is_on_the_screen() {
        let mut seen = Seen::new();
        let mut transmitter = Transmitter::new(NodeId::DEFAULT);
        let mut message =
            SlipMessage { sensors: 1, class: 2, slip: true, alarm: true, ..SlipMessage::default() };
        message.logits = [-2048, 0, 5 * 1024].map(Logit::from_bits);
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
            seen.accept(&LogEntry { timestamp_us: 0, interface: "can0".to_owned(), frame });
        }
        let mut terminal = Terminal::new(TestBackend::new(80, 26)).unwrap();
        terminal.draw(|frame| view(frame, &seen, false)).unwrap();
        let buffer = terminal.backend().buffer();
        let text: String = buffer.content().iter().map(|cell| cell.symbol()).collect();
        for words in
            ["node 42", "1 slip messages, 0 lost", "ALARM", "5.00 ███", "12345", "accelerometer clipped"]
        {
            assert!(text.contains(words), "{words} is in {text}");
        }
        // Head, facts, border, then eight lines of two rows.
        let cell = buffer.cell((1 + 8, 1 + FACTS_HEIGHT + 1 + 8)).unwrap();
        assert_eq!(cell.fg, Color::Rgb(255, 191, 91));
    }
}
