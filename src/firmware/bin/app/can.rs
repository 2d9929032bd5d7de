//! FDCAN1 on PD0 (RX) and PD1 (TX): CAN FD frames with bit rate switching, 1 Mbit/s arbitration.
//!
//! ```text
//! tasks::Transmission → a hardware buffer for each slot, smallest identifier first → transceiver
//!            ↑ FDCAN1_IT0: a frame has gone or was taken back, or the node has dropped off the bus
//! tasks::Services ← [`RECEIVED_FRAMES`] with their times ← [`receive`] ← Rx FIFO 0 ← filters ← transceiver
//! ```
//!
//! The three transmit buffers work as a queue by identifier (RM0433, Tx queue): a slip message does not wait behind
//! a raw frame that other nodes keep from the bus, as it would in the FIFO. embassy-stm32 0.6 aborts a queued frame
//! when it writes into a full queue, and loses it if it is longer than 8 bytes; three slots never overfill three
//! buffers.
//!
//! The filters let the node's own traffic through, so that the FIFO's three places do not fill with the raw frames of
//! other fingertips. They are emptied above inference: a transfer of several frames comes faster than a step ends.
//!
//! The NUCLEO carries no transceiver. Ran on no hardware so far.

use core::future::poll_fn;
use core::num::{NonZeroU8, NonZeroU16};
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Poll;

use embassy_futures::poll_once;
use embassy_stm32::can::config::{
    DataBitTiming, FrameTransmissionConfig, GlobalFilter, NominalBitTiming, TxBufferMode,
};
use embassy_stm32::can::filter::{Action, ExtendedFilter, ExtendedFilterSlot, FilterType};
use embassy_stm32::can::frame::{FdFrame, Header};
use embassy_stm32::can::{
    CanConfigurator, CanRx, CanTx, IT0InterruptHandler, IT1InterruptHandler, OperatingMode, Properties,
};
use embassy_stm32::interrupt::typelevel;
use embassy_stm32::{Peri, bind_interrupts, pac, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Instant, with_deadline};
use embedded_can::{ExtendedId, Id};
use slipsense::board::{CanReceive, CanTransmit, TxSlot};
use slipsense::firmware::clocks::FDCAN_KERNEL_HZ;
use slipsense::health::{CanState, CanStatus};
use slipsense::wire::CanFrame;

bind_interrupts!(struct Irqs {
    FDCAN1_IT0 => IT0InterruptHandler<peripherals::FDCAN1>, Changed;
    FDCAN1_IT1 => IT1InterruptHandler<peripherals::FDCAN1>;
});

/// Who waits for the hardware to change, and who for a frame.
static WAITING: AtomicWaker = AtomicWaker::new();
static RECEIVING: AtomicWaker = AtomicWaker::new();

/// Frames that wait for the node: more than the longest requests of two others at once. What does not fit is dropped,
/// as on a bus, and counted; the transfer fails and is asked for again.
const RECEIVED_FRAMES: usize = 32;
static RECEIVED: Channel<CriticalSectionRawMutex, (CanFrame, u64), RECEIVED_FRAMES> = Channel::new();
/// Lost on the way there; see [`lost_received`].
static LOST: AtomicU32 = AtomicU32::new(0);
/// Places of both FIFOs: more frames are not there at a time.
const FIFO_FRAMES: usize = 6;
/// Its three transmit buffers, a bit each.
const TX_BUFFERS: u32 = 0b111;
const FILTERS: [ExtendedFilterSlot; 4] =
    [ExtendedFilterSlot::_0, ExtendedFilterSlot::_1, ExtendedFilterSlot::_2, ExtendedFilterSlot::_3];

/// Second handler of the interrupt: the driver's own wakes only tasks that wait inside the driver.
struct Changed;

impl typelevel::Handler<typelevel::FDCAN1_IT0> for Changed {
    unsafe fn on_interrupt() {
        // The driver does not know of cancelled frames, and would not take the flag away.
        pac::FDCAN1.ir().write(|w| w.set_tcf(true));
        WAITING.wake();
        RECEIVING.wake();
    }
}

/// One bit in time quanta of the kernel clock (prescaler 1): the synchronisation quantum, then these.
struct BitTiming {
    seg1: u8,
    seg2: u8,
    sync_jump_width: u8,
}

impl BitTiming {
    /// Quanta from the start of the bit to its sample point.
    const fn sample_point(&self) -> u8 {
        1 + self.seg1
    }

    const fn bit_rate(&self) -> u32 {
        FDCAN_KERNEL_HZ / (self.sample_point() + self.seg2) as u32
    }
}

/// 1 Mbit/s, sampled at 80 %. The driver's `set_bitrate` caps a bit at 10 quanta with a jump width of 1, too coarse for
/// a bus that others drive from their own oscillators.
const NOMINAL: BitTiming = BitTiming { seg1: 63, seg2: 16, sync_jump_width: 16 };
/// 5 Mbit/s, sampled at 75 %: what any CAN FD transceiver carries.
const DATA_5M: BitTiming = BitTiming { seg1: 11, seg2: 4, sync_jump_width: 4 };
/// 8 Mbit/s, sampled at 80 %: needs a CAN SIC transceiver.
const DATA_8M: BitTiming = BitTiming { seg1: 7, seg2: 2, sync_jump_width: 2 };

/// The data phase at this bit rate; every node on the bus must be set to the same. The raw messages of one sensor
/// load a bus by 75 % at 8 Mbit/s and by 101 % at 5 Mbit/s, where some would be dropped.
const fn data_phase(bit_rate: u32) -> &'static BitTiming {
    // The settings allow no third.
    if bit_rate == DATA_5M.bit_rate() { &DATA_5M } else { &DATA_8M }
}

const _: () = {
    assert!(NOMINAL.bit_rate() == 1_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(1_000_000));
    assert!(DATA_5M.bit_rate() == 5_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(5_000_000));
    assert!(DATA_8M.bit_rate() == 8_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(8_000_000));
};

pub struct CanBus {
    tx: CanTx<'static>,
    /// The hardware buffer that each slot's last frame was put into.
    buffers: [Option<u8>; TxSlot::ALL.len()],
    seen: ([bool; TxSlot::ALL.len()], CanStatus),
}

impl CanBus {
    /// Configure and join the bus, with this bit rate in the data phase. Nothing is received before
    /// [`CanReceive::accept_only`].
    pub fn start(
        peripheral: Peri<'static, peripherals::FDCAN1>,
        rx: Peri<'static, peripherals::PD0>,
        tx: Peri<'static, peripherals::PD1>,
        data_bit_rate: u32,
        mode: OperatingMode,
    ) -> (Self, CanRx<'static>, Inbox) {
        let data = data_phase(data_bit_rate);
        // Never zero: the constants say so.
        let segment = |quanta| NonZeroU8::new(quanta).unwrap_or(NonZeroU8::MIN);
        let mut configurator = CanConfigurator::new(peripheral, rx, tx, Irqs);
        let config = configurator
            .config()
            .set_nominal_bit_timing(NominalBitTiming {
                prescaler: NonZeroU16::MIN,
                seg1: segment(NOMINAL.seg1),
                seg2: segment(NOMINAL.seg2),
                sync_jump_width: segment(NOMINAL.sync_jump_width),
            })
            .set_data_bit_timing(DataBitTiming {
                transceiver_delay_compensation: true,
                prescaler: NonZeroU16::MIN,
                seg1: segment(data.seg1),
                seg2: segment(data.seg2),
                sync_jump_width: segment(data.sync_jump_width),
            })
            .set_frame_transmit(FrameTransmissionConfig::AllowFdCanAndBRS)
            .set_tx_buffer_mode(TxBufferMode::Priority)
            .set_automatic_bus_off_recovery(true)
            .set_global_filter(GlobalFilter::reject_all());
        configurator.set_config(config);
        let can = configurator.start(mode);
        compensate_transceiver_delay(data);
        // A frame that was taken back wakes who waits for its buffer, as one that has gone does.
        pac::FDCAN1.txbcie().write(|w| w.0 = TX_BUFFERS);
        pac::FDCAN1.ie().modify(|w| w.set_tcfe(true));
        let (tx, rx, properties) = can.split();
        let bus = Self { tx, buffers: [None; 3], seen: ([true; 3], CanStatus::default()) };
        (bus, rx, Inbox { properties })
    }

    fn buffer(&self, slot: TxSlot) -> Option<usize> {
        self.buffers.get(slot as usize).copied().flatten().map(usize::from)
    }

    fn look(&mut self) -> ([bool; TxSlot::ALL.len()], CanStatus) {
        (TxSlot::ALL.map(|slot| self.is_free(slot)), self.status())
    }
}

impl CanTransmit for CanBus {
    fn is_free(&self, slot: TxSlot) -> bool {
        self.buffer(slot).is_none_or(|buffer| pac::FDCAN1.txbrp().read().0 & 1 << (buffer % 32) == 0)
    }

    fn transmit(&mut self, slot: TxSlot, frame: &CanFrame) {
        // Neither fails for a `CanFrame`: its identifier has 29 bits, its length is one of CAN FD's.
        let Some(id) = ExtendedId::new(frame.id()) else { return };
        let header = Header::new_fd(id.into(), frame.data().len() as u8, false, true);
        let Ok(frame) = FdFrame::new(header, frame.data()) else { return };
        // The driver puts the frame where this points to; there is room, so it does so at once.
        let buffer = pac::FDCAN1.txfqs().read().tfqpi();
        if poll_once(self.tx.write_fd(&frame)).is_ready() {
            // A free buffer may have been another slot's: whatever happens to it from now on is this slot's.
            for (other, of_slot) in self.buffers.iter_mut().enumerate() {
                if other == slot as usize {
                    *of_slot = Some(buffer);
                } else if *of_slot == Some(buffer) {
                    *of_slot = None;
                }
            }
        }
        self.seen = self.look();
    }

    fn withdraw(&mut self, slot: TxSlot) {
        if let Some(buffer) = self.buffer(slot) {
            pac::FDCAN1.txbcr().write(|w| w.0 = 1 << (buffer % 32));
        }
    }

    fn has_sent(&self, slot: TxSlot) -> bool {
        // Set when the frame has been acknowledged, also one whose cancellation came too late (RM0433, TXBTO).
        self.buffer(slot).is_some_and(|buffer| pac::FDCAN1.txbto().read().0 & 1 << (buffer % 32) != 0)
    }

    async fn changed(&mut self) {
        poll_fn(|context| {
            WAITING.register(context.waker());
            let now = self.look();
            if now == self.seen {
                return Poll::Pending;
            }
            self.seen = now;
            Poll::Ready(())
        })
        .await;
    }

    fn status(&mut self) -> CanStatus {
        // Reading clears the last error code, which nobody asks for.
        let protocol = pac::FDCAN1.psr().read();
        let counters = pac::FDCAN1.ecr().read();
        let state = match (protocol.bo(), protocol.ep(), protocol.ew()) {
            (true, _, _) => CanState::BusOff,
            (_, true, _) => CanState::ErrorPassive,
            (_, _, true) => CanState::Warning,
            _ => CanState::ErrorActive,
        };
        CanStatus { state, transmit_errors: counters.tec(), receive_errors: counters.rec() }
    }
}

/// From the FIFOs into [`RECEIVED`], for ever. It belongs on an executor above inference.
///
/// The driver's own wait is no use: on a disturbed bus it returns at once with the last error, again and again.
pub async fn receive(mut rx: CanRx<'static>) {
    poll_fn(|context| {
        RECEIVING.register(context.waker());
        for _ in 0..FIFO_FRAMES {
            let Poll::Ready(Ok(envelope)) = poll_once(rx.read_fd()) else { break };
            // As exact as this executor is prompt: what else it does takes some tens of microseconds.
            let at_us = Instant::now().as_micros();
            let Id::Extended(id) = envelope.frame.id() else { continue };
            let length = usize::from(envelope.frame.header().len());
            let data = envelope.frame.data().get(..length).unwrap_or_default();
            if let Ok(frame) = CanFrame::new(id.as_raw(), data)
                && RECEIVED.try_send((frame, at_us)).is_err()
            {
                lose_one();
            }
        }
        // The FIFO was full when a frame came (RM0433, IR.RF0L): at least one. After the frames, whose interrupt led here.
        if pac::FDCAN1.ir().read().rfl(0) {
            pac::FDCAN1.ir().write(|w| w.set_rfl(0, true));
            lose_one();
        }
        Poll::<()>::Pending
    })
    .await;
}

fn lose_one() {
    // Only [`receive`] counts.
    LOST.store(LOST.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
}

/// Frames of others that were let through and lost, since start.
#[allow(dead_code, reason = "the bring-up program includes this module and does not ask")]
pub fn lost_received() -> u32 {
    LOST.load(Ordering::Relaxed)
}

pub struct Inbox {
    properties: Properties,
}

impl CanReceive for Inbox {
    async fn receive(&mut self, until_us: u64) -> Option<(CanFrame, u64)> {
        with_deadline(Instant::from_micros(until_us), RECEIVED.receive()).await.ok()
    }

    fn accept_only(&mut self, filters: &[(u32, u32)]) {
        let mut filters = filters.iter();
        for slot in FILTERS {
            let filter = filters.next().map_or(ExtendedFilter::disable(), |&(filter, mask)| ExtendedFilter {
                filter: FilterType::BitMask { filter, mask },
                action: Action::StoreInFifo0,
            });
            self.properties.set_extended_filter(slot, filter);
        }
    }
}

/// Beyond 1 Mbit/s the transceiver's loop delay exceeds a bit. embassy-stm32 0.6 stores the setting and never writes it
/// (#5273). The offset puts the secondary sample point where the primary one lies.
fn compensate_transceiver_delay(data: &BitTiming) {
    let registers = pac::FDCAN1;
    registers.cccr().modify(|w| w.set_init(true));
    while !registers.cccr().read().init() {}
    registers.cccr().modify(|w| w.set_cce(true));
    registers.dbtp().modify(|w| w.set_tdc(true));
    registers.tdcr().write(|w| {
        w.set_tdco(data.sample_point());
        w.set_tdcf(0);
    });
    registers.cccr().modify(|w| w.set_cce(false));
    registers.cccr().modify(|w| w.set_init(false));
    while registers.cccr().read().init() {}
}
