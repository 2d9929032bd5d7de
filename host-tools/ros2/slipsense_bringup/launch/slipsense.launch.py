"""Start the node: `ros2 launch slipsense_bringup slipsense.launch.py source:=socketcan:can0`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    """The program `slipsense-ros2`, which `cargo install --path host-tools/ros2` puts on the path."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "source",
                default_value="socketcan:can0",
                description="socketcan:can0, slcan:/dev/ttyACM0, or a recording",
            ),
            DeclareLaunchArgument("namespace", default_value="/slipsense", description="Where the topics are"),
            ExecuteProcess(
                cmd=[
                    "slipsense-ros2",
                    "node",
                    LaunchConfiguration("source"),
                    "--namespace",
                    LaunchConfiguration("namespace"),
                ],
                output="screen",
            ),
        ]
    )
