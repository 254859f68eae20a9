"""Separate Python environments, for simulators and policies that conflict with the running one."""
