//! A model of the emulator with something of ours before and after each of its calls.

use rigless::device::{Device, DeviceContext as Context, ErasedDevice, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::time::{EventId, VirtualNanos};

/// Tokens of our own accesses: the trigger line's write to ADC1, reads of the address table (the index of the word
/// added), and a frame's writes.
pub const TRIGGER_TOKEN: u64 = u64::MAX;
pub const TABLE_TOKEN: u64 = 1 << 32;
pub const FRAME_TOKEN: u64 = TABLE_TOKEN - 1;

pub trait Tap<D> {
    /// Before an access, an event or a request reaches the model.
    fn before(&mut self, _device: &mut D, _now: VirtualNanos) {}

    /// What reaches the model of a write; `None`: nothing.
    fn write(&mut self, _: usize, value: u64, _: &mut RegisterFile, _: &mut Context<'_>) -> Option<u64> {
        Some(value)
    }

    /// Puts what the model does not know of into the registers, before an access or a request.
    fn show(&mut self, _registers: &mut RegisterFile, _now: VirtualNanos) {}

    /// A read that the model must not see.
    fn read_instead(&mut self, _row: usize, _registers: &RegisterFile, _now: VirtualNanos) -> Option<u64> {
        None
    }

    /// An event of ours. `true`: the model must not see it.
    fn event_instead(&mut self, _event: EventId, _context: &mut Context<'_>) -> bool {
        false
    }

    /// The answer to an access of ours.
    fn answered(&mut self, _token: u64, _value: u64, _context: &mut Context<'_>) {}

    /// What is read of what the model answers, or the register file where it does not.
    fn read(&mut self, _row: usize, value: Option<u64>, _registers: &RegisterFile) -> Option<u64> {
        value
    }

    fn after(&mut self, _device: &mut D, _registers: &mut RegisterFile, _context: &mut Context<'_>) {}

    fn on_clock(&mut self, _hz: u64, _now: VirtualNanos) {}

    fn reset(&mut self) {}
}

#[derive(Debug)]
pub struct Tapped<D, T> {
    pub device: D,
    pub tap: T,
}

impl<D: Device + 'static, T: Tap<D>> ErasedDevice for Tapped<D, T> {
    fn layout(&self) -> &'static [RegisterSpec] {
        ErasedDevice::layout(&self.device)
    }

    fn read(&mut self, row: usize, registers: &mut RegisterFile, context: &mut Context<'_>) -> Option<u64> {
        self.tap.before(&mut self.device, context.now());
        self.tap.show(registers, context.now());
        if let Some(value) = self.tap.read_instead(row, registers, context.now()) {
            return Some(value);
        }
        let value = ErasedDevice::read(&mut self.device, row, registers, context);
        let value = self.tap.read(row, value, registers);
        self.tap.after(&mut self.device, registers, context);
        value
    }

    fn peek(&self, row: usize, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        ErasedDevice::peek(&self.device, row, registers, now)
    }

    fn write(&mut self, row: usize, value: u64, registers: &mut RegisterFile, context: &mut Context<'_>) {
        self.tap.before(&mut self.device, context.now());
        self.tap.show(registers, context.now());
        if let Some(value) = self.tap.write(row, value, registers, context) {
            ErasedDevice::write(&mut self.device, row, value, registers, context);
        }
        self.tap.after(&mut self.device, registers, context);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut Context<'_>) {
        if self.tap.event_instead(event, context) {
            return;
        }
        self.tap.before(&mut self.device, context.now());
        ErasedDevice::on_event(&mut self.device, event, registers, context);
        self.tap.after(&mut self.device, registers, context);
    }

    fn on_request(&mut self, change: RequestChange, registers: &mut RegisterFile, context: &mut Context<'_>) {
        ErasedDevice::on_request(&mut self.device, change, registers, context);
        self.tap.after(&mut self.device, registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut Context<'_>) {
        ErasedDevice::on_clock(&mut self.device, hz, registers, context);
    }

    fn on_clock_input(
        &mut self,
        input: usize,
        hz: u64,
        registers: &mut RegisterFile,
        context: &mut Context<'_>,
    ) {
        self.tap.on_clock(hz, context.now());
        ErasedDevice::on_clock_input(&mut self.device, input, hz, registers, context);
        self.tap.after(&mut self.device, registers, context);
    }

    fn poll(&mut self, registers: &mut RegisterFile, context: &mut Context<'_>) {
        ErasedDevice::poll(&mut self.device, registers, context);
    }

    fn reset(&mut self) {
        ErasedDevice::reset(&mut self.device);
        self.tap.reset();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut Context<'_>) {
        ErasedDevice::reset_line(&mut self.device, registers, context);
        self.tap.reset();
    }

    fn on_access(&mut self, token: u64, value: u64, registers: &mut RegisterFile, context: &mut Context<'_>) {
        match token {
            TRIGGER_TOKEN => {}
            FRAME_TOKEN.. => self.tap.answered(token, value, context),
            _ => ErasedDevice::on_access(&mut self.device, token, value, registers, context),
        }
    }

    fn on_refused(&mut self, token: u64, registers: &mut RegisterFile, context: &mut Context<'_>) {
        if token < FRAME_TOKEN {
            ErasedDevice::on_refused(&mut self.device, token, registers, context);
        }
    }
}
