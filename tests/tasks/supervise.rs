//! The supervisor: any single task that stands still starves the watchdog.

use slipsense::tasks::{Progress, StallWatch, Supervisor, Task};

use super::world::Fed;

#[test]
fn each_single_stalled_task_starves_the_watchdog() {
    for stalled in Task::ALL {
        let (progress, mut supervisor, mut dog) = (Progress::new(), Supervisor::new(&Task::ALL), Fed(0));
        for round in 1..=50 {
            for task in Task::ALL {
                if task != stalled || round <= 10 {
                    progress.made(task);
                }
            }
            let fed = supervisor.look(&progress, &mut dog);
            assert_eq!(fed, if round <= 10 { Ok(()) } else { Err(stalled) });
            assert_eq!(dog.0, round.min(10));
        }
        progress.made(stalled);
        assert_eq!(supervisor.look(&progress, &mut dog), Ok(()), "{stalled:?} is back, the others moved on");
    }
}

#[test]
fn nobody_is_fed_before_everybody_has_begun() {
    let (progress, mut supervisor, mut dog) = (Progress::new(), Supervisor::new(&Task::ALL), Fed(0));
    for task in Task::ALL {
        assert_eq!(supervisor.look(&progress, &mut dog), Err(task));
        progress.made(task);
    }
    assert_eq!(supervisor.look(&progress, &mut dog), Ok(()));
    assert_eq!(supervisor.look(&progress, &mut dog), Err(Task::ALL[0]), "once per progress");
}

#[test]
fn tasks_that_stand_still_are_noted() {
    let (progress, mut watch) = (Progress::new(), StallWatch::new());
    for task in Task::ALL {
        progress.made(task);
    }
    assert_eq!(watch.look(&progress), 0);
    progress.made(Task::Acquire);
    progress.made(Task::Transmit);
    assert_eq!(watch.look(&progress), 1 << Task::Infer as u8 | 1 << Task::Services as u8);
    assert_eq!(watch.look(&progress), 0b1111);
}
