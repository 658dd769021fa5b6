//! measure
use reel_data_profile::*;
use std::time::Instant;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let start = Instant::now();
    let open = |i: usize| Table::open(&[std::path::PathBuf::from(&a[i])]).unwrap();
    match a[1].as_str() {
        "profile" => {
            let t = open(2);
            eprintln!("open {:?}", start.elapsed());
            let options = ProfileOptions {
                keys: a.get(3).into_iter().cloned().collect(),
                by: a.get(4).into_iter().cloned().collect(),
                top: 3,
            };
            println!("{}", profile(&t, &options).unwrap());
        }
        "diff" => println!(
            "{}",
            diff(
                &open(2),
                &open(3),
                &DiffOptions {
                    keys: a.get(4).into_iter().cloned().collect(),
                    ..DiffOptions::default()
                }
            )
            .unwrap()
        ),
        "join" => println!(
            "{}",
            join(
                &open(2),
                &open(3),
                &JoinOptions {
                    on: vec![a[4].clone()],
                    how: JoinHow::Inner,
                    out: a[5].clone().into()
                }
            )
            .unwrap()
        ),
        _ => panic!(),
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let hwm = status.lines().find(|l| l.starts_with("VmHWM")).unwrap();
    eprintln!("{:?} {hwm}", start.elapsed());
}
