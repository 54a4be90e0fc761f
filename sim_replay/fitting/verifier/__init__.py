"""Fly, train and weigh the network that separates mines from other objects and floor."""
