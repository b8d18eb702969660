"""A ROS 2 node around `siamloc.runtime.Localizer`."""
