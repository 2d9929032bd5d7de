//! The transmit scheduler: what a bus that is full, disturbed, silent or gone costs.

use std::cell::{Cell, RefCell};

use slipsense::board::TxSlot;
use slipsense::health::CanState;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::Output;
use slipsense::sensor::SensorReadings;
use slipsense::tasks::{RAW_MESSAGES, RuntimeConfig, SERVICE_FRAMES, Shared, Supervisor, Task};
use slipsense::wire::{CanFrame, Detail, MessageId, Origin, Priority, RawForm, Region, SlipMessage};
use slipsense_can_sim::controller::{Arrived, Bus, Disturbance};

use super::full_bus::compress;
use super::world::{BATCH, FRAME_NS, Fed, NODE, Ran, World, stamp, tick_ns};

/// Longest full frame at 1 and 8 Mbit/s with its intermission, worst stuffing, rounded up.
const FULL_FRAME_NS: u64 = 142_000;
const SECOND_NS: u64 = 1_000_000_000;

fn expected_slips(world: &World<'_>) -> Vec<SlipMessage> {
    let message =
        |(sequence, output): (u32, Output)| output.slip_message(stamp(sequence), &Origin::default());
    (0..).zip(world.outputs()).map(message).collect()
}

fn slips_are_right_or_replaced(world: &World<'_>, ran: &Ran) {
    let expected = expected_slips(world);
    assert!(ran.slips.iter().all(|slip| expected[slip.sequence as usize] == *slip));
    assert_eq!(ran.slips.len() as u32 + ran.status.replaced_slips, world.frames);
}

fn is_of(slot: TxSlot) -> impl Fn(&&Arrived) -> bool {
    move |arrived| arrived.slot == slot
}

/// Time from each slip message's tick to its last bit, by the order of arrival.
fn slip_times_ns(ran: &Ran) -> Vec<u64> {
    let arrived = ran.arrived.iter().filter(is_of(TxSlot::Slip)).zip(&ran.slips);
    arrived.map(|(arrived, message)| arrived.at_ns - tick_ns(message.sequence)).collect()
}

/// No raw message arrives in part, each arrives as the sensor gave it, and what did not arrive was counted or, at the
/// end, waits.
fn raw_is_whole_or_counted(world: &World<'_>, ran: &Ran, broken: u32) {
    let parts = (ran.status.broken_raw, ran.errors);
    assert_eq!(parts, (broken, 0), "no part of a message but over bus-off");
    let made = world.frames * world.sensors as u32;
    let waiting = if world.disturbance.foreign_load_percent == 100 { RAW_MESSAGES } else { 0 };
    assert_eq!(ran.waiting, waiting);
    assert_eq!((ran.raw.len() + waiting) as u32 + ran.status.dropped_raw + ran.status.broken_raw, made);
    for message in &ran.raw {
        let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
        (world.script)(message.sequence, &mut parts);
        let part = &parts[usize::from(message.sensor)];
        assert_eq!(message.piezo, part.piezo);
        assert_eq!(message.xl, part.xl.as_slice());
        assert_eq!(message.xl_end, (message.sequence + 1) * BATCH);
    }
}

#[test]
fn a_free_bus_carries_what_the_host_makes() {
    for form in [RawForm::Plain, RawForm::Compressed(Detail::All)] {
        let mut world = World::new(120, 1);
        if form != RawForm::Plain {
            world.before_tick = &compress;
        }
        let ran = world.run();
        let frames = |slot| ran.arrived.iter().filter(is_of(slot)).map(|arrived| arrived.frame);
        let sent = [TxSlot::Slip, TxSlot::Raw].map(|slot| frames(slot).collect::<Vec<_>>());
        assert!(sent == world.can_frames(form), "every CAN byte");
        assert!(ran.raw.iter().all(|message| message.region == Region::ALL));
        assert_eq!((ran.raw.len(), ran.status.dropped_raw, ran.status.replaced_slips), (120, 0, 0));
    }
}

#[test]
fn the_slip_message_waits_for_the_frame_on_the_wire_and_no_longer() {
    for (sensors, foreign_load_percent) in [(1, 0), (3, 0), (3, 50), (3, 100)] {
        let mut world = World::new(240, sensors);
        world.disturbance = Disturbance { foreign_load_percent, ..Disturbance::default() };
        let ran = world.run();
        assert_eq!(ran.slips, expected_slips(&world));
        let worst = slip_times_ns(&ran).into_iter().max().unwrap();
        assert!(worst <= 2 * FULL_FRAME_NS, "{worst} ns");
        raw_is_whole_or_counted(&world, &ran, 0);
    }
}

#[test]
fn a_bus_too_small_drops_whole_messages_of_all_sensors_in_turn() {
    let world = World::new(480, 3);
    let ran = world.run();
    raw_is_whole_or_counted(&world, &ran, 0);
    let shares = ran.shares();
    assert!(ran.status.dropped_raw > 600 && shares.iter().all(|&n| (150..250).contains(&n)), "{shares:?}");
    let in_order = ran.raw.is_sorted_by_key(|message| (message.sequence, message.sensor));
    assert!(in_order, "the sensors' order within a frame stays");
    // Of every third frame, beside others.
    let set = |shared: &Shared<_>, _| shared.set_config(RuntimeConfig { raw_every: 3, ..shared.config() });
    let disturbance = Disturbance { foreign_load_percent: 80, ..Disturbance::default() };
    let ran = World { before_tick: &set, disturbance, ..World::new(1_440, 3) }.run();
    let shares = ran.shares();
    assert!(ran.status.dropped_raw > 600 && shares.iter().all(|&n| (60..130).contains(&n)), "{shares:?}");
}

#[test]
fn others_of_higher_priority_keep_raw_messages_away_and_no_slip_message() {
    let mut world = World::new(240, 1);
    world.disturbance.foreign_load_percent = 100;
    let ran = world.run();
    assert_eq!(ran.slips, expected_slips(&world));
    assert!(ran.raw.is_empty(), "{} raw messages", ran.raw.len());
    // What the queue holds and the one that was begun are neither sent nor dropped.
    assert!((240 - 8..240).contains(&ran.status.dropped_raw), "{}", ran.status.dropped_raw);
}

#[test]
fn destroyed_frames_are_sent_again() {
    let mut world = World::new(240, 1);
    // One in ten: errors add 8 to the counter, nine good frames take 9 off.
    world.disturbance.error_every = 10;
    let ran = world.run();
    assert_eq!(ran.slips, expected_slips(&world));
    assert_eq!((ran.status.bus_offs, ran.status.replaced_slips), (0, 0));
    raw_is_whole_or_counted(&world, &ran, 0);
}

#[test]
fn too_many_errors_end_in_bus_off_and_recovery_again_and_again() {
    let mut world = World::new(480, 1);
    world.disturbance.error_every = 2;
    let ran = world.run();
    assert!(ran.status.bus_offs > 3, "{:?}", ran.status);
    slips_are_right_or_replaced(&world, &ran);
    assert!(ran.errors as u32 <= ran.status.broken_raw);
}

#[test]
fn without_acknowledge_the_newest_slip_message_waits_and_no_old_one_is_delivered() {
    let mut world = World::new(480, 1);
    world.disturbance.silent_ns = SECOND_NS / 2..SECOND_NS * 3 / 2;
    let seen_passive = Cell::new(false);
    let look = |shared: &Shared<_>, _| {
        seen_passive.set(seen_passive.get() | (shared.status().can.state == CanState::ErrorPassive));
    };
    world.before_tick = &look;
    let ran = world.run();
    assert!(seen_passive.get());
    assert_eq!(ran.status.bus_offs, 0, "a node that nobody acknowledges stays on the bus");
    slips_are_right_or_replaced(&world, &ran);
    let oldest = slip_times_ns(&ran).into_iter().max().unwrap();
    assert!(oldest <= FRAME_NS + 3 * FULL_FRAME_NS, "{oldest} ns old");
    raw_is_whole_or_counted(&world, &ran, 0);
}

#[test]
fn two_seconds_of_bus_off_cost_the_slip_messages_of_two_seconds() {
    let mut world = World::new(960, 1);
    let dominant_ns = SECOND_NS..3 * SECOND_NS;
    world.disturbance.dominant_ns = dominant_ns.clone();
    let off = Cell::new(0);
    let look = |shared: &Shared<_>, _| {
        off.set(off.get() + u32::from(shared.status().can.state == CanState::BusOff));
    };
    world.before_tick = &look;
    let ran = world.run();
    assert_eq!(ran.status.bus_offs, 1);
    assert_eq!(ran.status.can.state, CanState::ErrorActive, "and that is over");
    assert!((479..=481).contains(&off.get()), "the status says it all the while: {} frames", off.get());
    slips_are_right_or_replaced(&world, &ran);

    let mut slips = ran.arrived.iter().filter(is_of(TxSlot::Slip)).zip(&ran.slips);
    let (first, message) = slips.find(|(slip, _)| slip.at_ns > dominant_ns.end).unwrap();
    let age_ns = first.at_ns - tick_ns(message.sequence);
    // 128 times 11 bits, and the message itself.
    assert!(first.at_ns - dominant_ns.end <= 1_408_000 + FULL_FRAME_NS + 1000);
    assert!(age_ns <= FRAME_NS + FULL_FRAME_NS, "the newest, not the first of two seconds");
    assert!((2_001_408..2_001_600).contains(&ran.status.bus_off_us), "{}", ran.status.bus_off_us);
    raw_is_whole_or_counted(&world, &ran, ran.status.broken_raw);
    assert!(ran.status.broken_raw <= 1);
    assert_eq!(ran.raw.last().unwrap().sequence, 959, "raw messages go on");
}

#[test]
fn service_frames_go_in_order_and_one_too_many_is_refused() {
    let push = |shared: &Shared<_>, tick: u32| {
        // At tick 100 more than there is room for.
        let count = if tick == 100 { SERVICE_FRAMES as u32 + 5 } else { 1 };
        for n in 0..count {
            let room = shared.service_room();
            assert_eq!(shared.send_service(numbered(Priority::Nominal, tick * 100 + n)), room > 0);
        }
    };
    let ran = World { before_tick: &push, ..World::new(240, 3) }.run();
    let numbers: Vec<u32> = arrived_services(&ran).iter().map(|(number, _)| *number).collect();
    assert!(numbers.is_sorted());
    let refused = ran.status.refused_services;
    assert!((4..=5).contains(&refused), "{refused}");
    assert_eq!(numbers.len() as u32 + refused, 239 + SERVICE_FRAMES as u32 + 5);
    assert!(slip_times_ns(&ran).into_iter().max().unwrap() <= 2 * FULL_FRAME_NS);
}

fn numbered(priority: Priority, n: u32) -> CanFrame {
    let id = MessageId { priority, port: 7509, node: NODE };
    CanFrame::new(id.to_can(), &n.to_le_bytes()).unwrap()
}

/// The others leave the bus at tick 120.
fn free(tick: u32, bus: &mut Bus) {
    if tick == 120 {
        bus.disturb(Disturbance::default());
    }
}

/// Numbers of the service frames that arrived, and when.
fn arrived_services(ran: &Ran) -> Vec<(u32, u64)> {
    let number = |arrived: &Arrived| u32::from_le_bytes(arrived.frame.data().try_into().unwrap());
    let arrived = ran.arrived.iter().filter(is_of(TxSlot::Service));
    arrived.map(|arrived| (number(arrived), arrived.at_ns)).collect()
}

/// What the hardware holds is lost with the bus, and so is what made way for the heartbeat in it: counted, not sent later.
#[test]
fn service_frames_are_lost_with_the_bus_and_counted() {
    for (service, heartbeat, lost) in [(false, false, 0), (true, false, 1), (false, true, 1), (true, true, 2)]
    {
        let push = |shared: &Shared<_>, tick: u32| match tick {
            10 => assert!(!service || shared.send_service(numbered(Priority::Optional, 10))),
            20 => assert!(!heartbeat || shared.send_heartbeat(numbered(Priority::Optional, 20))),
            150 => assert!(shared.send_service(numbered(Priority::Optional, 150))),
            _ => {}
        };
        // From the middle of a slip message on.
        let dominant_ns = tick_ns(50) + 50_000..tick_ns(60);
        let disturbance = Disturbance { foreign_load_percent: 100, dominant_ns, ..Disturbance::default() };
        let ran = World { before_tick: &push, on_bus: &free, disturbance, ..World::new(240, 1) }.run();
        assert_eq!(arrived_services(&ran).iter().map(|(number, _)| *number).collect::<Vec<_>>(), [150]);
        assert_eq!((ran.status.lost_services, ran.status.refused_services), (lost, 0));
        assert_eq!(ran.slips.len() as u32 + ran.status.replaced_slips, 240);
    }
}

/// The frame that the hardware holds makes way, and comes after the heartbeat, once.
#[test]
fn a_heartbeat_overtakes_what_others_keep_from_the_bus() {
    let push = |shared: &Shared<_>, tick: u32| match tick {
        10..20 => assert!(shared.send_service(numbered(Priority::Optional, tick))),
        30 | 60 | 90 => assert!(shared.send_heartbeat(numbered(Priority::Fast, tick))),
        _ => {}
    };
    let disturbance = Disturbance { foreign_load_percent: 100, ..Disturbance::default() };
    let ran = World { before_tick: &push, on_bus: &free, disturbance, ..World::new(240, 1) }.run();
    let arrived = arrived_services(&ran);
    let numbers: Vec<u32> = arrived.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, [&[30, 60, 90][..], &Vec::from_iter(10..20)].concat());
    assert!(arrived[..3].iter().all(|(number, at_ns)| *at_ns < tick_ns(*number)));
    assert_eq!((ran.status.refused_services, ran.status.lost_services), (0, 0));
}

#[test]
fn raw_messages_of_every_third_frame_or_of_none() {
    for (raw_every, expected) in [(0, 0), (1, 240), (3, 80)] {
        let set = |shared: &Shared<_>, _| shared.set_config(RuntimeConfig { raw_every, ..shared.config() });
        let ran = World { before_tick: &set, ..World::new(240, 1) }.run();
        assert_eq!(ran.raw.len(), expected);
        assert_eq!((ran.slips.len(), ran.status.dropped_raw), (240, 0));
    }
}

#[test]
fn without_an_address_nothing_is_sent_and_no_task_stands_still() {
    let watched = [Task::Acquire, Task::Infer, Task::Transmit];
    let watch = RefCell::new((Supervisor::new(&watched), Fed(0)));
    let look = |shared: &Shared<_>, tick| {
        if tick == 0 {
            shared.set_config(RuntimeConfig { node: None, ..shared.config() });
        } else if tick % 2 == 0 {
            // Inference and transmission of the frame before come after this.
            let (supervisor, watchdog) = &mut *watch.borrow_mut();
            assert_eq!(supervisor.look(&shared.progress, watchdog), Ok(()), "before frame {tick}");
        }
    };
    assert!(World { before_tick: &look, ..World::new(240, 1) }.run().arrived.is_empty());
    assert_eq!(watch.borrow().1.0, 119);
}
