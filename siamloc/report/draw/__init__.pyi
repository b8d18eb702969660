from .suitable import pictures as pictures, save_all as save_all
