//! FDCAN1 on PD0 (RX) and PD1 (TX): CAN FD frames with bit rate switching, 1 Mbit/s arbitration.
//!
//! ```text
//! CanBus::transmit → software queue → FDCAN1_IT0 → three hardware slots, first in first out → transceiver
//! ```
//!
//! The queue holds what one sensor sends in a frame period, so that the bus drains it while the next
//! frame is being computed. A bus that takes nothing (off, unterminated, nobody acknowledges) costs one
//! short wait and then refuses frames at once, so that inference goes on; the sender counts what is lost.
//! FIFO order, because in priority order embassy-stm32 0.6 aborts a queued frame and loses it if it is
//! longer than 8 bytes. Nothing is received yet: all frames are filtered.
//!
//! The NUCLEO carries no transceiver. Ran on no hardware so far.

use core::num::{NonZeroU8, NonZeroU16};

use embassy_stm32::can::config::{
    DataBitTiming, FrameTransmissionConfig, GlobalFilter, NominalBitTiming, TxBufferMode,
};
use embassy_stm32::can::enums::BusErrorMode;
use embassy_stm32::can::frame::{FdFrame, Header};
use embassy_stm32::can::{
    BufferedCanFd, BufferedFdCanSender, CanConfigurator, IT0InterruptHandler, IT1InterruptHandler,
    OperatingMode, RxFdBuf, TxFdBuf,
};
use embassy_stm32::{Peri, bind_interrupts, pac, peripherals};
use embassy_sync::channel::Channel;
use embassy_time::{Duration, with_timeout};
use embedded_can::ExtendedId;
use slipsense::board::CanTransmit;
use slipsense::wire::CanFrame;
use static_cell::StaticCell;

use super::clocks::FDCAN_KERNEL_HZ;

bind_interrupts!(struct Irqs {
    FDCAN1_IT0 => IT0InterruptHandler<peripherals::FDCAN1>;
    FDCAN1_IT1 => IT1InterruptHandler<peripherals::FDCAN1>;
});

/// Frames that wait for one of the hardware's three slots: a slip message and one sensor's raw message.
const TX_QUEUE: usize = 32;
/// Patience with a full queue. A 64-byte frame at 5 Mbit/s takes at most 170 µs; two of them may be
/// another node's.
const STALL: Duration = Duration::from_micros(500);
/// The driver insists on a queue; the filter lets nothing in.
const RX_QUEUE: usize = 1;

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

/// 1 Mbit/s, sampled at 80 %. By hand, because the driver's `set_bitrate` caps a bit at 10 quanta with a
/// jump width of 1, too coarse for a bus that others drive from their own oscillators.
const NOMINAL: BitTiming = BitTiming { seg1: 63, seg2: 16, sync_jump_width: 16 };
/// 5 Mbit/s, sampled at 75 %: what any CAN FD transceiver carries.
const DATA_5M: BitTiming = BitTiming { seg1: 11, seg2: 4, sync_jump_width: 4 };
/// 8 Mbit/s, sampled at 80 %: needs a CAN SIC transceiver.
const DATA_8M: BitTiming = BitTiming { seg1: 7, seg2: 2, sync_jump_width: 2 };
/// The data phase in use; every node on the bus must be set to the same. The raw messages of one sensor
/// load a bus by 75 % at 8 Mbit/s and by 101 % at 5 Mbit/s, where frames would be refused.
const DATA: BitTiming = DATA_8M;

const _: () = {
    assert!(NOMINAL.bit_rate() == 1_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(1_000_000));
    assert!(DATA_5M.bit_rate() == 5_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(5_000_000));
    assert!(DATA_8M.bit_rate() == 8_000_000 && FDCAN_KERNEL_HZ.is_multiple_of(8_000_000));
};

const fn nonzero(n: u8) -> NonZeroU8 {
    match NonZeroU8::new(n) {
        Some(n) => n,
        None => panic!("a bit segment is at least one quantum"),
    }
}

/// Where messages leave.
pub struct CanBus {
    bus: BufferedCanFd<'static, TX_QUEUE, RX_QUEUE>,
    sender: BufferedFdCanSender,
    stalled: bool,
}

/// A frame that found no place in the queue.
#[derive(Clone, Copy, Debug)]
pub struct QueueFull;

impl CanBus {
    /// Configure and join the bus. `None` the second time.
    pub fn start(
        peripheral: Peri<'static, peripherals::FDCAN1>,
        rx: Peri<'static, peripherals::PD0>,
        tx: Peri<'static, peripherals::PD1>,
    ) -> Option<Self> {
        static TX: StaticCell<TxFdBuf<TX_QUEUE>> = StaticCell::new();
        static RX: StaticCell<RxFdBuf<RX_QUEUE>> = StaticCell::new();
        let tx_buffer = TX.try_init(Channel::new())?;
        let rx_buffer = RX.try_init(Channel::new())?;

        let mut configurator = CanConfigurator::new(peripheral, rx, tx, Irqs);
        let config = configurator
            .config()
            .set_nominal_bit_timing(NominalBitTiming {
                prescaler: NonZeroU16::MIN,
                seg1: const { nonzero(NOMINAL.seg1) },
                seg2: const { nonzero(NOMINAL.seg2) },
                sync_jump_width: const { nonzero(NOMINAL.sync_jump_width) },
            })
            .set_data_bit_timing(DataBitTiming {
                transceiver_delay_compensation: true,
                prescaler: NonZeroU16::MIN,
                seg1: const { nonzero(DATA.seg1) },
                seg2: const { nonzero(DATA.seg2) },
                sync_jump_width: const { nonzero(DATA.sync_jump_width) },
            })
            .set_frame_transmit(FrameTransmissionConfig::AllowFdCanAndBRS)
            .set_tx_buffer_mode(TxBufferMode::Fifo)
            .set_automatic_bus_off_recovery(true)
            .set_global_filter(GlobalFilter::reject_all());
        configurator.set_config(config);
        let can = configurator.start(OperatingMode::NormalOperationMode);
        compensate_transceiver_delay();
        let bus = can.buffered_fd(tx_buffer, rx_buffer);
        let sender = bus.writer();
        Some(Self { bus, sender, stalled: false })
    }

    /// Did the node drop off the bus after too many errors? It rejoins by itself.
    pub fn is_off(&self) -> bool {
        matches!(self.bus.properties().bus_error_mode(), BusErrorMode::BusOff)
    }
}

impl CanTransmit for CanBus {
    type Error = QueueFull;

    async fn transmit(&mut self, frame: &CanFrame) -> Result<(), QueueFull> {
        // Neither fails for a `CanFrame`: its identifier has 29 bits, its length is one of CAN FD's.
        let id = ExtendedId::new(frame.id()).ok_or(QueueFull)?;
        let header = Header::new_fd(id.into(), frame.data().len() as u8, false, true);
        let frame = FdFrame::new(header, frame.data()).map_err(|_| QueueFull)?;
        let sent = if self.stalled {
            self.sender.try_write(frame).map_err(|_| QueueFull)
        } else {
            with_timeout(STALL, self.sender.write(frame)).await.map_err(|_| QueueFull)
        };
        self.stalled = sent.is_err();
        sent
    }
}

/// Beyond 1 Mbit/s the transceiver's loop delay exceeds a bit, and a sender that compares without
/// allowing for it sees errors. embassy-stm32 0.6 stores the setting and never writes it (#5273). The
/// offset puts the secondary sample point where the primary one lies.
fn compensate_transceiver_delay() {
    let registers = pac::FDCAN1;
    registers.cccr().modify(|w| w.set_init(true));
    while !registers.cccr().read().init() {}
    registers.cccr().modify(|w| w.set_cce(true));
    registers.dbtp().modify(|w| w.set_tdc(true));
    registers.tdcr().write(|w| {
        w.set_tdco(DATA.sample_point());
        w.set_tdcf(0);
    });
    registers.cccr().modify(|w| w.set_cce(false));
    registers.cccr().modify(|w| w.set_init(false));
    while registers.cccr().read().init() {}
}
